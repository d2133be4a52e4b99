"""Carves a grid of points by the silhouettes of pinhole cameras; the reference beside the kernel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.compiled import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

FAR = np.float32(1e6)
"""Signed distance, metres, before any camera has limited it."""


class PinholeRecord(NamedTuple):
    """A camera for kernels.

    Attributes:
        world_from_camera: [4, 4], OpenCV axes, metres.
        fx, fy, cx, cy: pixels; pixel centres lie at +0.5.
    """

    world_from_camera: F64
    fx: float
    fy: float
    cx: float
    cy: float


class GridRecord(NamedTuple):
    """Grid points `origin + step * (i, j, k)`.

    Attributes:
        origin: [3] world metres.
        step: metres.
    """

    origin: F64
    step: float


def pinhole_record(camera: Camera, pose: int | None) -> PinholeRecord:
    """The camera of a frame for kernels.

    Raises:
        ValueError: its lens distorts; pictures and camera are undistorted first (capture/undistort.py).
    """
    lens = camera.lens(pose)
    if lens.distortion.acts:
        raise ValueError("carving needs a camera without distortion")
    world_from_camera = np.ascontiguousarray(camera.pose(pose), np.float64).copy()
    return PinholeRecord(world_from_camera, lens.fx, lens.fy, lens.cx, lens.cy)


@compiled(nogil=True, error_model="numpy")
def carve(field: F32, count: NDArray[np.uint8], grid: GridRecord, camera: PinholeRecord, signed: F32) -> None:
    """Limits the signed distance of every grid point by one silhouette, in place.

    Args:
        field: [X, Y, Z] float32 signed distance so far, metres, positive inside.
        count: [X, Y, Z] uint8 number of cameras that have a point in their picture.
        grid: a `GridRecord`.
        camera: a `PinholeRecord`.
        signed: [H, W] float32 signed distance to the silhouette's edge, pixels, positive inside.
    """
    height, width = signed.shape
    pose = camera.world_from_camera
    focal = 0.5 * (camera.fx + camera.fy)
    for i in range(field.shape[0]):
        dx = grid.origin[0] + grid.step * i - pose[0, 3]
        for j in range(field.shape[1]):
            dy = grid.origin[1] + grid.step * j - pose[1, 3]
            for k in range(field.shape[2]):
                dz = grid.origin[2] + grid.step * k - pose[2, 3]
                z = pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz
                if z <= 0:
                    continue
                x = camera.fx * (pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz) / z + camera.cx
                y = camera.fy * (pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz) / z + camera.cy
                if not (0 <= x < width and 0 <= y < height):
                    continue
                count[i, j, k] += 1
                u, v = min(max(x - 0.5, 0.0), width - 1.0), min(max(y - 0.5, 0.0), height - 1.0)
                left, top = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
                right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
                a, b = u - left, v - top
                upper = (1 - a) * signed[top, left] + a * signed[top, right]
                lower = (1 - a) * signed[bottom, left] + a * signed[bottom, right]
                distance = np.float32(((1 - b) * upper + b * lower) * z / focal)
                if distance < field[i, j, k]:
                    field[i, j, k] = distance


def signed_distance(points: F64, camera: Camera, pose: int | None, signed: F32) -> tuple[F32, NDArray[np.bool_]]:
    """What one silhouette says of points: the reference of `carve`.

    Args:
        points: [..., 3] world metres.
        camera: without distortion.
        pose: what `Camera.pose` takes.
        signed: [H, W] as for `carve`.

    Returns:
        Signed distance [...], metres, and whether the camera has the point in its picture.
    """
    from scipy.ndimage import map_coordinates

    height, width = signed.shape
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z = np.moveaxis(camera.project(points, pose), -1, 0)
        seen = (z > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    at = np.where(seen, y - 0.5, 0), np.where(seen, x - 0.5, 0)
    pixels = map_coordinates(signed.astype(np.float64), at, order=1, mode="nearest")
    lens = camera.lens(pose)
    metres = pixels * z / (0.5 * (lens.fx + lens.fy))
    return np.where(seen, metres, FAR).astype(np.float32), seen
