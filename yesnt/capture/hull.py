"""The visual hull: the largest body that agrees with the silhouettes of all cameras, by carving a grid of points.

Each silhouette becomes a signed distance to its edge, in pixels. A grid point is as far inside the hull as its least
distance over the cameras that have it in their picture, in metres at its depth. The surface is where this is 0; it is
smooth below the grid's step. What a camera does not have in its picture it does not carve. Laurentini 1994, "The
Visual Hull Concept for Silhouette-Based Image Understanding"; surface points as in Gibson 1998, "Surface Nets".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.carving import FAR, GridRecord, carve, pinhole_record
from yesnt.capture.volume import Volume, common_volume
from yesnt.core.camera import Camera

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Int32 = NDArray[np.int32]

RESOLUTION = 96
"""Grid points along the longest side."""

KEPT_SHARE = 0.02
"""Share of the largest component's points below which a component is left out: silhouettes cross in free space too."""

WELL_SEEN = 0.75
"""Share of the cameras that see the best seen component that must see another one: where few pictures overlap, their
silhouettes cross behind and beside the subject, and nobody else can say that nothing is there."""

_COARSE = (48, 64)  # points along the longest side of the grids that find the subject's box
_EDGE = (0.02, 0.98)  # coverage between which a pixel itself tells where the edge lies
_OUT = 10.0  # steps outside, for points that too few cameras have in their picture


@dataclass(frozen=True)
class Silhouette:
    """The subject as one camera sees it.

    Attributes:
        name: of the camera.
        camera: without distortion.
        pose: what `Camera.pose` takes: the frame, or None of a camera at rest.
        matte: [H, W] coverage in [0, 1].
    """

    name: str
    camera: Camera
    pose: int | None
    matte: F32


@dataclass(frozen=True)
class Hull:
    """A visual hull.

    Attributes:
        points: [N, 3] float32 on its surface, world metres, about one per `spacing`; in the grid's order.
        normals: [N, 3] float32 unit, outward.
        spacing: step of the grid, metres.
        origin: [3] float64 first grid point, world metres.
        field: [X, Y, Z] float32 signed distance at the grid points, metres, positive inside.
        seen: [X, Y, Z] uint8 number of cameras that have a grid point in their picture.
    """

    points: F32
    normals: F32
    spacing: float
    origin: F64
    field: F32
    seen: NDArray[np.uint8]

    @property
    def empty(self) -> bool:
        """Whether the silhouettes agree nowhere."""
        return not len(self.points)

    def mesh(self) -> tuple[F32, Int32]:
        """Triangles of the surface: vertices [V, 3] world metres and faces [F, 3], outward by the right-hand rule.

        Raises:
            ValueError: the hull is empty.
        """
        from skimage.measure import marching_cubes

        padded = np.pad(self.field, 1, constant_values=-_OUT * self.spacing)
        vertices, faces, _, _ = marching_cubes(padded, 0.0, spacing=(self.spacing,) * 3, gradient_direction="ascent")
        return (vertices - self.spacing + self.origin).astype(np.float32), np.ascontiguousarray(faces, np.int32)


def visual_hull(
    views: Sequence[Silhouette], resolution: int = RESOLUTION, volume: Volume | None = None, least: int | None = None
) -> Hull:
    """The visual hull of one moment.

    Args:
        views: at least one; their order does not matter.
        resolution: grid points along the longest side of the subject's box.
        volume: box that holds the subject, world metres; None: found from what the cameras have in common.
        least: cameras that must have a point in their picture; None: half of them, at least two (or the only one).

    Returns:
        The hull; `empty` if the silhouettes agree nowhere.

    Raises:
        ValueError: no view, a camera that distorts, or cameras whose pictures have no volume in common.
    """
    least = required_views(len(views)) if least is None else least
    distances = [edge_distance(view.matte) for view in views]
    if volume is None:
        volume = common_volume([(view.camera, view.pose) for view in views], least)
    for coarse in _COARSE:
        field, seen, grid = _carved(views, distances, volume, coarse, least)
        volume = _around(field, seen, grid, volume)
    field, seen, grid = _carved(views, distances, volume, resolution, least)
    return _surface(_without_crumbs(field, seen, grid.step), seen, grid)


def required_views(count: int) -> int:
    """How many of `count` cameras must have a point in their picture for it to count."""
    return max(min(2, count), (count + 1) // 2)


def edge_distance(matte: F32) -> F32:
    """Signed distance [H, W] of pixel centres to the edge of a matte, pixels, positive inside.

    The edge is where coverage is one half. Where a pixel is partly covered, its coverage says by how much of a pixel.
    """
    import cv2

    inside = np.ascontiguousarray(matte > 0.5)
    if inside.all() or not inside.any():
        return np.full(matte.shape, max(matte.shape) if inside.all() else -max(matte.shape), np.float32)
    within, outside = (
        _exact(cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
        for part in (inside, ~inside)
    )
    distance = np.where(inside, within - 0.5, 0.5 - outside)
    partly = (matte > _EDGE[0]) & (matte < _EDGE[1]) & (np.abs(distance) <= 0.5)
    return np.where(partly, matte - 0.5, distance).astype(np.float32)


def _exact(distance: F32) -> F32:
    """Distances whose squares are whole numbers, as distances between pixels are.

    OpenCV's square root differs in its last bit from call to call, with the array's place in memory.
    """
    return np.sqrt(np.rint(np.square(distance, dtype=np.float64))).astype(np.float32)


def _carved(
    views: Sequence[Silhouette], distances: Sequence[F32], volume: Volume, resolution: int, least: int
) -> tuple[F32, NDArray[np.uint8], GridRecord]:
    """Signed distance, cameras that have each point in their picture, and the grid of a box."""
    size = volume.high - volume.low
    step = float(size.max()) / (resolution - 1)
    shape = np.ceil(size / step - 1e-9).astype(int) + 1
    grid = GridRecord(np.ascontiguousarray(volume.low, np.float64), step)
    field, seen = np.full(shape, FAR, np.float32), np.zeros(shape, np.uint8)
    for view, distance in zip(views, distances, strict=True):
        carve(field, seen, grid, pinhole_record(view.camera, view.pose), distance)
    field[seen < least] = -_OUT * step
    return np.clip(field, -_OUT * step, _OUT * step), seen, grid


def _around(field: F32, seen: NDArray[np.uint8], grid: GridRecord, volume: Volume) -> Volume:
    """The box of the points that may lie within a step of the hull; the whole box if there is none."""
    near = field > -1.8 * grid.step  # the diagonal of a cell: no thin limb falls between the points
    found = np.argwhere(well_seen(near, seen))
    if not len(found):
        return volume
    return Volume(grid.origin + grid.step * (found.min(axis=0) - 1), grid.origin + grid.step * (found.max(axis=0) + 1))


def well_seen(points: NDArray[np.bool_], seen: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The components of points [X, Y, Z] that enough cameras see, by the number of cameras [X, Y, Z] of each point."""
    from scipy.ndimage import label

    labels, count = label(points)
    if count < 2:
        return points
    return np.asarray(_seen_enough(labels, seen)[labels] & points)


def _seen_enough(labels: Int32, seen: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which labels enough cameras see at some point."""
    most = np.zeros(int(labels.max()) + 1, np.uint8)
    np.maximum.at(most, labels.ravel(), seen.ravel())
    most[0] = 0
    return np.asarray(most >= WELL_SEEN * most.max())


def _without_crumbs(field: F32, seen: NDArray[np.uint8], step: float) -> F32:
    """The field without components that are small, or that few cameras see."""
    from scipy.ndimage import find_objects, label

    labels, count = label(field > 0)
    if count < 2:
        return field
    enough = _seen_enough(labels, seen)
    sizes = np.bincount(labels.ravel())
    sizes[~enough] = 0
    sizes[0] = 0
    result = field.copy()
    for number, box in enumerate(find_objects(labels), 1):
        if not enough[number] or sizes[number] < KEPT_SHARE * sizes.max():
            part = result[box]
            part[labels[box] == number] = -0.1 * step
    return result


def _surface(field: F32, seen: NDArray[np.uint8], grid: GridRecord) -> Hull:
    """One point in every cell that the surface crosses: the mean of where it crosses the cell's edges."""
    padded = np.pad(field, 1, constant_values=-_OUT * grid.step)
    total, crossings = np.zeros((*(np.array(padded.shape) - 1), 3)), np.zeros(np.array(padded.shape) - 1, np.int32)
    cells = padded.shape[0] - 1, padded.shape[1] - 1, padded.shape[2] - 1
    for axis in range(3):
        first, second = _ends(padded, axis)
        crossed = (first > 0) != (second > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(crossed, first / (first - second), 0)
        others = [a for a in range(3) if a != axis]
        for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):  # the cell's four edges along this axis
            part = [slice(None)] * 3
            for other, s in zip(others, shift, strict=True):
                part[other] = slice(s, s + cells[other])
            hit = crossed[tuple(part)]
            crossings += hit
            total[..., axis] += np.where(hit, share[tuple(part)], 0)
            for other, s in zip(others, shift, strict=True):
                total[..., other] += s * hit
    index = np.argwhere(crossings > 0)
    at = tuple(index.T)
    local = index + total[at] / crossings[at][:, None]
    normals = _outward(padded, local)
    points = grid.origin + grid.step * (local - 1)
    return Hull(points.astype(np.float32), normals.astype(np.float32), grid.step, grid.origin, field, seen)


def _ends(values: F32, axis: int) -> tuple[F32, F32]:
    """Values at both ends of all edges along an axis."""
    count = values.shape[axis]
    return values.take(range(count - 1), axis), values.take(range(1, count), axis)


def _outward(field: F32, places: F64) -> F64:
    """Unit vectors against the field's slope at places [N, 3] in steps."""
    from scipy.ndimage import map_coordinates

    slope = np.stack([map_coordinates(part, places.T, order=1) for part in np.gradient(field)], axis=-1)
    centre = places.mean(axis=0) if len(places) else np.zeros(3)
    flat = np.linalg.norm(slope, axis=-1) < 1e-9  # a sheet thinner than a step: away from the middle
    outward = np.where(flat[:, None], places - centre, -slope)
    return outward / np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1e-12)
