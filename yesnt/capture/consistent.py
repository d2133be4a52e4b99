"""Makes the mattes of one moment agree by the visual hull: what the other cameras contradict leaves, holes are filled.

A camera's pixel may show the subject only where its ray meets a point that the other cameras cover. Where all others
cover such a point and the camera itself is unsure, it is taken for the subject.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.carving import FAR, GridRecord, carve, pinhole_record
from yesnt.capture.hull import KEPT_SHARE, Silhouette, edge_distance, required_views, well_seen
from yesnt.capture.volume import Volume, common_volume

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

GRIDS = (48, 128)
"""Grid points along the longest side: the first finds the subject's box; the second is the largest."""

_POINTS_PER_PIXEL = 0.7  # of the largest matte: a finer grid would show nothing more

TOLERANCE = 1.0
"""Pixels by which silhouettes may miss each other, beside a grid step."""

FORGIVEN_OUT, FORGIVEN_IN = 0.15, 0.1
"""Share of the other cameras that may have missed a part that is kept (at least one of three), or that is filled."""

ODDS, MOST_ODDS = 0.2, 3.0
"""Log odds that each camera beyond two adds where they cover a filled point, and their largest sum: the hull of few
cameras is much larger than the subject."""


@dataclass(frozen=True)
class Support:
    """What the other cameras say of one camera's picture.

    Attributes:
        kept: [H, W] in [0, 1], 0 where nothing that the others cover lies on the ray.
        log_odds: [H, W], at least 0: by how much they take the pixel for the subject.
    """

    kept: F32
    log_odds: F32

    def applied(self, probability: F32) -> F32:
        """A camera's own probability [H, W] with what the others say."""
        own = np.clip(probability.astype(np.float64), 0.01, 0.99)
        odds = own / (1 - own) * np.exp(self.log_odds)
        return (self.kept * np.where(self.log_odds > 0, odds / (1 + odds), probability)).astype(np.float32)


def support_of(views: Sequence[Silhouette]) -> list[Support]:
    """What the other cameras say of each camera's picture.

    Args:
        views: mattes of one moment, without distortion.

    Raises:
        ValueError: a camera that distorts, or cameras whose pictures have no volume in common.
    """
    if len(views) < 2:
        return [Support(np.ones_like(v.matte), np.zeros_like(v.matte)) for v in views]
    distances = [edge_distance(view.matte) for view in views]
    volume = common_volume([(view.camera, view.pose) for view in views], required_views(len(views)))
    votes = _Votes.of(views, distances, volume, GRIDS[0])
    found = np.argwhere(np.any([votes.supported(n) & votes.near[n] for n in range(len(views))], axis=0))
    if not len(found):
        return [Support(np.ones_like(v.matte), np.zeros_like(v.matte)) for v in views]
    ends = (found.min(0), -1), (found.max(0), 1)
    low, high = (votes.grid.origin + votes.grid.step * (end + pad) for end, pad in ends)
    votes = _Votes.of(views, distances, Volume(low, high), _resolution(views))
    return [_support(votes, number, view) for number, view in enumerate(views)]


def _resolution(views: Sequence[Silhouette]) -> int:
    sides = [np.ptp(np.flatnonzero((view.matte > 0.5).any(axis=axis))) for view in views for axis in (0, 1)
             if (view.matte > 0.5).any()]  # fmt: skip
    return int(np.clip(_POINTS_PER_PIXEL * max(sides, default=0), *GRIDS))


@dataclass(frozen=True)
class _Votes:
    """What V silhouettes cover of a grid.

    Attributes:
        near: [V, X, Y, Z] bool covered, or nearly.
        inside: [V, X, Y, Z] bool covered.
        seen: [V, X, Y, Z] bool in the picture.
        grid: the grid.
    """

    near: Bool
    inside: Bool
    seen: Bool
    grid: GridRecord

    @classmethod
    def of(cls, views: Sequence[Silhouette], distances: Sequence[F32], volume: Volume, resolution: int) -> _Votes:
        size = volume.high - volume.low
        step = float(size.max()) / (resolution - 1)
        shape = tuple(np.ceil(size / step - 1e-9).astype(int) + 1)
        grid = GridRecord(np.ascontiguousarray(volume.low, np.float64), step)
        near, inside, seen = np.zeros((3, len(views), *shape), bool)
        for number, (view, distance) in enumerate(zip(views, distances, strict=True)):
            field, count = np.full(shape, FAR, np.float32), np.zeros(shape, np.uint8)
            carve(field, count, grid, pinhole_record(view.camera, view.pose), distance)
            reach = TOLERANCE * _metres_of_a_pixel(view, grid, shape)
            seen[number] = count > 0
            near[number] = seen[number] & (field > -step - reach)
            inside[number] = seen[number] & (field > 0)
        return cls(near, inside, seen, grid)

    def supported(self, number: int) -> Bool:
        """Points that may be the subject for one camera, since the others cover them."""
        others, covering = _without(self.seen, number), _without(self.near, number)
        forgiven = np.maximum(np.where(others >= 3, 1, 0), np.floor(FORGIVEN_OUT * others))
        enough = others >= max(1, required_views(len(self.seen)) - 1)
        supported = self.seen[number] & enough & (covering >= others - forgiven)
        return _largest(well_seen(supported, self.seen.sum(axis=0, dtype=np.uint8)))

    def filled(self, number: int) -> tuple[Bool, NDArray[np.int64]]:
        """Points that the others take for the subject whatever this camera shows, and by how many of them."""
        others, covering = _without(self.seen, number), _without(self.inside, number)
        enough = (others >= 3) & (covering >= others - np.floor(FORGIVEN_IN * others))
        return self.seen[number] & enough, covering


def _without(votes: Bool, number: int) -> NDArray[np.int64]:
    return votes.sum(axis=0, dtype=np.int64) - votes[number]


def _metres_of_a_pixel(view: Silhouette, grid: GridRecord, shape: tuple[int, ...]) -> float:
    """How wide a pixel is at the middle of a grid."""
    middle = grid.origin + 0.5 * grid.step * (np.array(shape) - 1)
    lens, pose = view.camera.lens(view.pose), view.camera.pose(view.pose)
    z = float((middle - pose[:3, 3]) @ pose[:3, 2])
    return abs(z) / (0.5 * (lens.fx + lens.fy))


def _largest(points: Bool) -> Bool:
    """The components of a grid that are not small beside the largest: silhouettes cross in free space too."""
    from scipy.ndimage import label

    labels, count = label(points)
    if not count:
        return points
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray((sizes >= KEPT_SHARE * sizes.max())[labels] & points)


def _support(votes: _Votes, number: int, view: Silhouette) -> Support:
    kept = _shown(view, votes.grid, votes.supported(number), 1)
    filled, covering = votes.filled(number)
    count = covering[filled].mean() if filled.any() else 0.0
    odds = min(MOST_ODDS, ODDS * max(float(count) - 2, 0.0))
    return Support(kept, (odds * np.minimum(kept, _shown(view, votes.grid, filled, 0))).astype(np.float32))


def _shown(view: Silhouette, grid: GridRecord, points: Bool, grow: int) -> F32:
    """1 where points of a grid, each as wide as a step, cover a picture, [H, W]; 0 elsewhere, with a soft border."""
    import cv2

    height, width = view.matte.shape
    index = np.argwhere(points)
    if not len(index):
        return np.zeros((height, width), np.float32)
    x, y, z = view.camera.project(grid.origin + grid.step * index, view.pose).T
    lens = view.camera.lens(view.pose)
    cell = max(1.0, 0.5 * (lens.fx + lens.fy) * grid.step / float(np.median(z)))
    rows, columns = int(height / cell) + 1, int(width / cell) + 1
    mask = np.zeros((rows, columns), np.uint8)
    mask[np.clip((y / cell).astype(int), 0, rows - 1), np.clip((x / cell).astype(int), 0, columns - 1)] = 1
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    if grow:
        mask = cv2.dilate(mask, np.ones((3, 3), np.uint8), iterations=grow)
    back = np.array([[1 / cell, 0, 0.5 / cell - 0.5], [0, 1 / cell, 0.5 / cell - 0.5]])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(mask.astype(np.float32), back, (width, height), flags=how, borderMode=cv2.BORDER_REPLICATE)
    )
