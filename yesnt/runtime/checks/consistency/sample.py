"""A sample of a frame's covered pixels in camera space, where its inputs are compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.io.shot_inputs import Plate, Surface

F64 = NDArray[np.float64]

MOST = 6000
"""Pixels that are compared: their shares are then known to 1 %."""

_STEPS = 64
"""Steps across a subject's width over which depth is compared: over one pixel of a large picture, half floats round
its change away."""

LEAST = 50
"""Pixels below which nothing is concluded."""


GOOD = 0.9
"""Share from which normals, or a proxy, agree with the camera and with depth."""

SLOPES = 0.75
"""The same of slopes of depth: noise and normal maps turn the sign of gentle ones."""


@dataclass(frozen=True)
class Sample:
    """P covered pixels of one frame.

    Attributes:
        ray: [P, 3] direction of the pixel in camera axes (OpenCV), z = 1.
        normal: [P, 3] as the job says, in camera axes; lengths are kept.
        z: [P] planar metres, 0 where there is none.
        color: [P, 3] straight, linear Rec.709.
        pose: [4, 4] `world_from_camera`.
        steps: [S, 2] change of ray x and y between two neighbours of a pixel on both sides in its row or column.
        slopes: [S] change of the logarithm of z along these steps.
        step_pixel: [S] the pixel of each step, in P.
    """

    ray: F64
    normal: F64
    z: F64
    color: F64
    pose: F64
    steps: F64
    slopes: F64
    step_pixel: NDArray[np.int64]

    @property
    def world_normal(self) -> F64:
        """Normals [P, 3] in world axes."""
        return self.normal @ self.pose[:3, :3].T

    @property
    def extent(self) -> float:
        """Length of the box that holds 98 % of the pixels' points, metres; 0 without a depth."""
        points = self.ray[self.z > 0] * self.z[self.z > 0, None]
        return float(np.ptp(np.percentile(points, (1, 99), axis=0), axis=0).max()) if len(points) else 0.0

    def scaled(self, factor: float) -> Sample:
        """The same pixels at another depth."""
        return replace(self, z=self.z * factor)


def take_sample(camera: Camera, frame: int, plate: Plate, surface: Surface) -> Sample:
    """Chooses covered pixels evenly, always the same ones."""
    pose = camera.pose(frame)
    inside = plate.matte > 0.5
    covered = np.flatnonzero(inside)
    index = covered[:: max(1, -(-len(covered) // MOST))]
    ray = camera.rays(frame).astype(np.float64) @ pose[:3, :3]
    normal, z = (array.reshape(inside.size, -1)[index].astype(np.float64) for array in (surface.normal, surface.z))
    color = plate.color.reshape(-1, 3)[index].astype(np.float64)
    steps = _neighbours(index, ray, np.where(inside, surface.z, 0), max(1, int(np.sqrt(len(covered)) / _STEPS)))
    return Sample(ray.reshape(-1, 3)[index], normal @ pose[:3, :3], z[:, 0], color, pose, *steps)


def _neighbours(
    index: NDArray[np.int64], ray: F64, z: NDArray[np.float32], reach: int
) -> tuple[F64, F64, NDArray[np.int64]]:
    """`Sample.steps`, `slopes` and `step_pixel` of the pixels whose neighbours at `reach` have a depth."""
    height, width = z.shape
    row, column = np.divmod(index, width)
    steps, slopes, pixels = [], [], []
    for down, across in ((0, reach), (reach, 0)):
        inside = (row >= down) & (row < height - down) & (column >= across) & (column < width - across)
        r, c = row[inside], column[inside]
        before, after = z[r - down, c - across].astype(np.float64), z[r + down, c + across].astype(np.float64)
        known = (before > 0) & (after > 0)
        r, c = r[known], c[known]
        steps.append((ray[r + down, c + across] - ray[r - down, c - across])[:, :2])
        slopes.append(np.log(after[known] / before[known]))
        pixels.append(np.flatnonzero(inside)[known])
    return np.concatenate(steps), np.concatenate(slopes), np.concatenate(pixels)
