"""How well the silhouettes of several cameras agree, and which usual mistake explains that they do not.

A subject lies inside the hull of all silhouettes, so each matte must be covered by the hull's picture. A camera that is
mirrored, named wrongly, inverted, badly calibrated or out of time cuts the hull, and the mattes are no longer covered.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.hull import Silhouette, edge_distance, required_views
from yesnt.capture.volume import Volume, common_volume, has_in_picture

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Int = NDArray[np.int64]

AGREE = 0.9
"""Least share of a matte that the hull covers where cameras agree."""

SURE = 0.99
"""Share from which nothing is looked for."""

EXPLAINS, LEFT = 0.02, 0.35
"""A mistake is named if undoing it covers this share more, and leaves at most this part of what was not covered."""

MOST_SWAPS = 24
"""Cameras up to which every two names are tried the other way round."""

_GRIDS = (40, 64)  # points along the longest side: of the common volume, and of the subject's box
_SLACK = 1.0  # pixels beside a grid step by which silhouettes may miss each other
_TELLING = 0.004  # share of the mattes by which a better offset must be better
_BORDER = 0.5  # share of a picture's border that a subject covers at most


@dataclass(frozen=True)
class _Seen:
    """A grid as one camera sees it: pixel and cell of each of G points, and the reach of a point in pixels."""

    known: NDArray[np.bool_]
    pixel: Int
    cell: Int
    slack: F32
    cells: tuple[int, int]


class Agreement:
    """Compares the silhouettes of one moment on one grid.

    Args:
        views: at least two, without distortion.
        strict: silhouettes may not miss each other at all; for comparisons, since even those that agree then lose some.

    Raises:
        ValueError: cameras whose pictures have no volume in common.
    """

    def __init__(self, views: Sequence[Silhouette], strict: bool = False) -> None:
        self.views, self._strict = tuple(views), strict
        self.least = required_views(len(views))
        volume = common_volume([(view.camera, view.pose) for view in views], self.least)
        for number, resolution in enumerate(_GRIDS):
            self._place(volume, resolution)
            if number == 0:
                volume = self._box(volume)

    def covered(self, mattes: Sequence[F32]) -> F64:
        """Share of each of V mattes that the picture of their common hull covers, [V]; 1 for an empty matte."""
        return self._covered_by(mattes, [self._inside(number, matte) for number, matte in enumerate(mattes)])

    def covered_with(self, number: int, others: Sequence[F32]) -> Iterator[F64]:
        """The same with each of several other mattes in place of one view's own."""
        mattes, inside = [view.matte for view in self.views], list(self._own)
        for other in others:
            mattes[number], inside[number] = other, self._inside(number, other)
            yield self._covered_by(mattes, inside)

    @cached_property
    def _own(self) -> list[NDArray[np.bool_]]:
        return [self._inside(number, view.matte) for number, view in enumerate(self.views)]

    def _covered_by(self, mattes: Sequence[F32], inside: Sequence[NDArray[np.bool_]]) -> F64:
        """As `covered`, of mattes whose points are known."""
        known = np.stack([seen.known for seen in self._seen])
        hull = (np.stack(inside) | ~known).all(axis=0) & (known.sum(axis=0) >= self.least)
        return np.array([self._share(number, matte, hull) for number, matte in enumerate(mattes)])

    def _place(self, volume: Volume, resolution: int) -> None:
        size = volume.high - volume.low
        self.step = float(size.max()) / (resolution - 1)
        axes = [low + self.step * np.arange(int(np.ceil(side / self.step)) + 1)
                for low, side in zip(volume.low, size, strict=True)]  # fmt: skip
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self._seen = [self._seen_by(view) for view in self.views]

    def _seen_by(self, view: Silhouette) -> _Seen:
        camera = view.camera
        with np.errstate(invalid="ignore", divide="ignore"):
            x, y, z = camera.project(self.points, view.pose).T
        known = has_in_picture(camera, view.pose, self.points)
        x, y, z = (np.where(known, part, 1.0) for part in (x, y, z))
        focal = 0.5 * (camera.fx + camera.fy)
        side = max(1.0, self.step * focal / float(np.median(z[known]) if known.any() else 1.0))
        cells = int(camera.height / side) + 1, int(camera.width / side) + 1
        pixel = y.astype(np.int64) * camera.width + x.astype(np.int64)
        cell = (y / side).astype(np.int64) * cells[1] + (x / side).astype(np.int64)
        return _Seen(known, pixel, cell, (_SLACK + 0.6 * self.step * focal / z).astype(np.float32), cells)

    def _inside(self, number: int, matte: F32) -> NDArray[np.bool_]:
        seen = self._seen[number]
        slack = 0 if self._strict else seen.slack
        return np.asarray(seen.known & (edge_distance(matte).ravel()[seen.pixel] > -slack))

    def _box(self, volume: Volume) -> Volume:
        """The box of what most cameras cover: one that is wrong does not move it."""
        inside = np.stack([self._inside(number, view.matte) for number, view in enumerate(self.views)])
        votes, known = inside.sum(axis=0), np.stack([seen.known for seen in self._seen]).sum(axis=0)
        found = self.points[(votes > 0.6 * known) & (known >= self.least)]
        return Volume(found.min(axis=0) - self.step, found.max(axis=0) + self.step) if len(found) else volume

    def _share(self, number: int, matte: F32, hull: NDArray[np.bool_]) -> float:
        import cv2

        seen = self._seen[number]
        hit = np.zeros(seen.cells, np.uint8)
        hit.ravel()[seen.cell[hull & seen.known]] = 1
        hit = hit if self._strict else cv2.dilate(hit, np.ones((3, 3), np.uint8))
        weight = cv2.resize(matte, seen.cells[::-1], interpolation=cv2.INTER_AREA)
        total = float(weight.sum())
        return float((weight * hit).sum()) / total if total > 0 else 1.0


@dataclass(frozen=True)
class Finding:
    """A mistake that explains why cameras do not agree.

    Attributes:
        what: in one clause.
        cameras: the cameras that it concerns.
        before: least covered share of a matte as the capture is.
        after: the same with the mistake undone; equal to `before` where it cannot be undone.
        do: what the user can do.
    """

    what: str
    cameras: tuple[str, ...]
    before: float
    after: float
    do: str

    @property
    def text(self) -> str:
        """One paragraph."""
        found = f" (of the worst matte {self.before:.0%} agree with the other cameras"
        found += f"; with this undone {self.after:.0%})" if self.after > self.before else ")"
        return f"{self.what}{found}. Do: {self.do}."


def find_mistakes(views: Sequence[Silhouette]) -> tuple[Finding, ...]:
    """What is wrong with the silhouettes of one moment; nothing if they agree.

    Raises:
        ValueError: cameras whose pictures have no volume in common.
    """
    agreement = Agreement(views)
    mattes = [view.matte for view in views]
    before = float(agreement.covered(mattes).min())
    inverted = {number for number, matte in enumerate(mattes) if _covers_border(matte)}
    if inverted:
        return (_inverted(views, inverted, before),)
    if before >= SURE or len(views) < 3:
        return ()
    tried = [(float(agreement.covered(undone).min()), made) for made, undone in _mistakes(views, mattes)]
    after, best = max(tried, key=lambda one: one[0])
    if _explains(before, after):
        return (replace(best, before=before, after=after),)
    return () if before >= AGREE else (_unexplained(agreement, views, mattes, before),)


def _inverted(views: Sequence[Silhouette], which: set[int], before: float) -> Finding:
    undone = [replace(v, matte=1 - v.matte) if number in which else v for number, v in enumerate(views)]
    after = float(Agreement(undone).covered([view.matte for view in undone]).min())
    names = tuple(views[number].name for number in sorted(which))
    return Finding(
        f"The matte of camera {', '.join(names)} is inverted: it covers the picture's border", names,
        min(before, after), after, "write coverage as 1 on the subject and 0 around it",
    )  # fmt: skip


def _explains(before: float, after: float) -> bool:
    return after >= before + EXPLAINS and 1 - after <= LEFT * (1 - before)


def _mistakes(views: Sequence[Silhouette], mattes: list[F32]) -> Iterator[tuple[Finding, list[F32]]]:
    """Every mistake that can be undone, and the mattes with it undone."""
    for number, view in enumerate(views):
        undone = list(mattes)
        undone[number] = np.ascontiguousarray(mattes[number][:, ::-1])
        yield Finding(
            f"The picture of camera {view.name} is mirrored", (view.name,), 0, 0,
            "flop its pictures and mattes, or mirror them in the camera's settings",
        ), undone  # fmt: skip
    if len(views) > MOST_SWAPS:
        return
    for i, j in combinations(range(len(views)), 2):
        if mattes[i].shape == mattes[j].shape:
            undone = list(mattes)
            undone[i], undone[j] = mattes[j], mattes[i]
            names = views[i].name, views[j].name
            yield Finding(
                f"Cameras {names[0]} and {names[1]} are in the wrong order: each has the other's pictures", names, 0, 0,
                "exchange their names in the calibration or their folders",
            ), undone  # fmt: skip


def _unexplained(agreement: Agreement, views: Sequence[Silhouette], mattes: Sequence[F32], before: float) -> Finding:
    """The camera without which the others agree best, else all of them."""
    nothing = [np.ones_like(matte) for matte in mattes]  # covers everything: it carves nothing
    without = []
    for number in range(len(views)):
        shares = agreement.covered([nothing[n] if n == number else m for n, m in enumerate(mattes)])
        without.append(float(np.delete(shares, number).min()))
    best = int(np.argmax(without))
    if not _explains(before, without[best]):
        names = tuple(view.name for view in views)
        return Finding(
            "The cameras do not agree on where the subject is", names, before, before,
            "check the calibration, its `units` and `up`, the names of the cameras, and that mattes show the subject",
        )  # fmt: skip
    name = views[best].name
    return Finding(
        f"Camera {name} contradicts all others", (name,), before, without[best],
        f"check its calibration, its matte and its time (`capture.offsets`), or leave {name} out of the calibration",
    )  # fmt: skip


def _covers_border(matte: F32) -> bool:
    border = np.concatenate([matte[0], matte[-1], matte[:, 0], matte[:, -1]])
    return float(border.mean()) > _BORDER


def estimate_offsets(moments: Mapping[int, Sequence[Silhouette]], reach: int) -> dict[str, int]:
    """Frames by which each camera is late, by how its silhouettes agree with the others'; 0 where none is better.

    Args:
        moments: views of consecutive frames by frame number, the same cameras in the same order.
        reach: largest offset that is tried.
    """
    frames = sorted(moments)
    inner = [frame for frame in frames if frame - reach in moments and frame + reach in moments]
    names = [view.name for view in moments[frames[0]]]
    late = dict.fromkeys(names, 0)
    for _ in names:  # the one that explains most first: what disagrees with it then agrees
        scores = _scores(moments, inner, late, reach)
        gain = {name: max(found.values()) - found[late[name]] for name, found in scores.items()}
        best = max(names, key=lambda name: gain[name])
        if gain[best] <= _TELLING:
            break
        late[best] = _latest(scores[best])
    return late


def _scores(
    moments: Mapping[int, Sequence[Silhouette]], inner: Sequence[int], late: Mapping[str, int], reach: int
) -> dict[str, dict[int, float]]:
    """Mean covered share of all mattes for each offset of each camera, the others at the offsets known so far."""
    scores = {name: dict.fromkeys(range(-reach, reach + 1), 0.0) for name in late}
    for frame in inner:
        views = [moments[frame + offset][number] for number, offset in enumerate(late.values())]
        agreement = Agreement(views, strict=True)
        for number, name in enumerate(late):
            moved = [moments[frame + offset][number].matte for offset in scores[name]]
            for offset, shares in zip(scores[name], agreement.covered_with(number, moved), strict=True):
                scores[name][offset] += float(shares.mean()) / len(inner)
    return scores


def _latest(scores: Mapping[int, float]) -> int:
    """The best offset; the smallest among those that are as good, since a subject at rest tells nothing."""
    best = max(scores.values())
    good = [offset for offset, score in scores.items() if score > best - _TELLING]
    return 0 if 0 in good else min(good, key=abs)


def estimate_gains(points: F32, normals: F32, views: Sequence[tuple[Silhouette, F32]]) -> dict[str, tuple[float, ...]]:
    """Factors of red, green, blue that bring each camera to the others' mean, by what they show of the same points.

    Args:
        points: [N, 3] on the subject's surface, world metres.
        normals: [N, 3] outward.
        views: silhouette and radiance [H, W, 3] of each camera.
    """
    logs = np.full((len(views), len(points), 3), np.nan)
    for number, (view, radiance) in enumerate(views):
        at = has_in_picture(view.camera, view.pose, points.astype(np.float64))
        way = view.camera.position(view.pose) - points
        facing = (normals * way).sum(-1) > 0.3 * np.linalg.norm(way, axis=-1)
        x, y, _ = view.camera.project(points, view.pose).T
        row, column = (np.where(at, part, 0).astype(np.int64) for part in (y, x))
        shown = radiance[row, column]
        good = at & facing & (view.matte[row, column] > 0.99) & (np.nan_to_num(shown).min(axis=-1) > 1e-3)
        logs[number, good] = np.log(shown[good])
    common = np.isfinite(logs).all(axis=-1).sum(axis=0) >= 2
    gain = np.zeros((len(views), 3))
    if not common.any():
        return {view.name: (1.0, 1.0, 1.0) for view, _ in views}
    logs = logs[:, common]
    for _ in range(60):
        residual = logs + gain[:, None] - np.nanmean(logs + gain[:, None], axis=0)
        for number in range(len(views)):
            if np.isfinite(residual[number]).any():
                gain[number] -= np.nanmedian(residual[number], axis=0)
        gain -= gain.mean(axis=0)
    return {view.name: tuple(float(v) for v in np.exp(row)) for (view, _), row in zip(views, gain, strict=True)}
