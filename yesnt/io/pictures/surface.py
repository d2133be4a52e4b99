"""The one place where z and normals of a G-buffer get their meaning: planar metres, world space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.camera_axes import AXES, UNITS
from yesnt.core.shot import GBufferInput

F32 = NDArray[np.float32]

MISS_Z = 1e9
"""Planar depth at or beyond this, or at most 0, or not finite, means "nothing was hit" (Blender writes 1e10)."""


def planar_z(stored: F32, spec: GBufferInput, camera: Camera, frame: int) -> F32:
    """Depth [H, W] as stored in a file, to planar metres; 0 where nothing was hit.

    Args:
        stored: [H, W] planar depth, distance along the ray or the inverse of planar depth, as `spec.z_kind` says, in
            `spec.units`.
        spec: the G-buffer's section of the job.
        camera: the shot's camera.
        frame: frame number; selects the lens.
    """
    hit = np.isfinite(stored) & (stored > 0) & (stored < MISS_Z)
    z = np.where(hit, stored, 0).astype(np.float32)
    if spec.z_kind == "inverse":
        z = np.where(hit, 1 / np.maximum(z, np.finfo(np.float32).tiny), 0)
        z = np.where(z < MISS_Z, z, 0)
    if spec.z_kind == "ray":
        z = z / np.linalg.norm(camera.rays(frame), axis=-1)
    return (z * np.float32(UNITS[spec.units])).astype(np.float32)


def world_normals(stored: F32, spec: GBufferInput, camera: Camera, frame: int) -> F32:
    """Normals [H, W, 3] as stored in a file, to world space; lengths are kept."""
    if spec.normal_range == "unsigned":
        stored = np.where((stored != 0).any(-1, keepdims=True), 2 * stored - 1, 0)  # black: nothing was hit
    if spec.normal_space == "world_y_up":
        stored = stored[..., [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    elif spec.normal_space != "world":
        to_opencv = AXES["opengl" if spec.normal_space == "camera_opengl" else "opencv"]
        stored = stored @ (camera.pose(frame)[:3, :3] * to_opencv).T.astype(np.float32)
    return stored.astype(np.float32)
