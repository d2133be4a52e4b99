"""Shadow rays marched in view space against the depth buffer: for shots without a proxy, and the paper's single factor.

A depth buffer has no thickness. What lies more than `thickness` behind it is taken to be free: a hand before the chest
then shades what is close to it and does not blacken the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from yesnt.relight.points import Pixels, Surface, has_depth

F32 = NDArray[np.float32]

_REACH = 0.6  # of the subject's height: longer shadows fall where one view no longer knows what is between


@dataclass(frozen=True)
class DepthScene:
    """Depth buffer and what it takes to march it.

    Attributes:
        z: [H, W] planar metres, infinite where nothing is.
        camera_from_world: [3, 4].
        intrinsics: [4] fx, fy, cx, cy, pixels.
        reach: metres of the longest march.
        thickness: metres behind the buffer that occlude.
    """

    z: F32
    camera_from_world: F32
    intrinsics: F32
    reach: float
    thickness: float


def depth_scene(surface: Surface, pixels: Pixels, thickness: float) -> DepthScene:
    """Prepares a march; `thickness` 0 takes it from the matte's typical half width at its depth."""
    z = np.asarray(surface.z, dtype=np.float32)
    covered = np.nan_to_num(np.asarray(surface.opacity, dtype=np.float32)) > 0.5
    known = has_depth(z) & covered
    buffer = np.where(known, z, np.inf).astype(np.float32)
    pose = surface.camera.pose(surface.frame)
    inverse = np.concatenate([pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3:]], axis=1).astype(np.float32)
    camera = surface.camera
    depth = float(np.median(z[known])) if known.any() else 1.0
    extent = float(np.ptp(np.nonzero(known)[0])) * depth / camera.fy if known.any() else 1.0
    scale = np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32)
    return DepthScene(buffer, inverse, scale, _REACH * extent, thickness or _half_width(known) * depth / camera.fx)


def _half_width(known: NDArray[np.bool_]) -> float:
    """Half the median run of covered pixels along rows: bodies and limbs are about as deep as they are wide."""
    edges = np.diff(np.pad(known.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    runs = np.nonzero(edges == -1)[1] - np.nonzero(edges == 1)[1]
    return 0.5 * float(np.median(runs)) if len(runs) else 1.0


def march(scene: DepthScene, origins: F32, normals: F32, directions: F32, steps: int) -> NDArray[np.bool_]:
    """Whether something lies between points [P, 3] and directions [3, C]: [P, C]; below a point's horizon nothing."""
    hidden = np.zeros((len(origins), directions.shape[1]), dtype=np.bool_)
    _march(
        scene.z,
        scene.camera_from_world,
        scene.intrinsics,
        np.float32(scene.reach),
        np.float32(scene.thickness),
        (np.ascontiguousarray(origins), np.ascontiguousarray(normals), np.ascontiguousarray(directions)),
        steps,
        hidden,
    )
    return hidden


@njit(cache=True, parallel=True, error_model="numpy")
def _march(z, to_camera, scale, reach, thickness, rays, steps, hidden):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    origins, normals, directions = rays
    for p in prange(hidden.shape[0]):
        for c in range(hidden.shape[1]):
            dx, dy, dz = directions[0, c], directions[1, c], directions[2, c]
            if normals[p, 0] * dx + normals[p, 1] * dy + normals[p, 2] * dz > np.float32(0):
                hidden[p, c] = _march_ray(z, to_camera, scale, reach, thickness, origins[p], (dx, dy, dz), steps)


@njit(cache=True, error_model="numpy")
def _march_ray(z, to_camera, scale, reach, thickness, origin, along, steps):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """True if the ray dives behind the buffer by less than the thickness; steps grow: contacts are near."""
    height, width = z.shape
    for i in range(1, steps + 1):
        share = np.float32(i) / np.float32(steps)
        distance = reach * share * share
        wx, wy, wz = (
            origin[0] + along[0] * distance,
            origin[1] + along[1] * distance,
            origin[2] + along[2] * distance,
        )
        cz = to_camera[2, 0] * wx + to_camera[2, 1] * wy + to_camera[2, 2] * wz + to_camera[2, 3]
        if cz <= np.float32(0):
            return False
        cx = to_camera[0, 0] * wx + to_camera[0, 1] * wy + to_camera[0, 2] * wz + to_camera[0, 3]
        cy = to_camera[1, 0] * wx + to_camera[1, 1] * wy + to_camera[1, 2] * wz + to_camera[1, 3]
        column = int(np.floor(scale[0] * cx / cz + scale[2]))
        row = int(np.floor(scale[1] * cy / cz + scale[3]))
        if column < 0 or row < 0 or column >= width or row >= height:
            return False
        behind = cz - z[row, column]
        margin = np.float32(0.02) * distance + np.float32(2.0) * cz / scale[0]  # two pixels: the surface's own slope
        if margin < behind < thickness + margin:
            return True
    return False
