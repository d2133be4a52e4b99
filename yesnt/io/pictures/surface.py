"""The one place where z and normals of a G-buffer get their meaning: planar metres, world space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.shot import GBufferInput

F32 = NDArray[np.float32]

MISS_Z = 1e9
"""Planar depth at or beyond this, or at most 0, or not finite, means "nothing was hit" (Blender writes 1e10)."""


def planar_z(stored: F32, spec: GBufferInput, camera: Camera) -> F32:
    """Depth [H, W] as stored in a file, to planar metres; 0 where nothing was hit."""
    hit = np.isfinite(stored) & (stored > 0) & (stored < MISS_Z)
    return np.where(hit, stored, 0).astype(np.float32)


def world_normals(stored: F32, spec: GBufferInput, camera: Camera, frame: int) -> F32:
    """Normals [H, W, 3] as stored in a file, to world space; lengths are kept."""
    if spec.normal_space == "camera":
        stored = stored @ camera.pose(frame)[:3, :3].T.astype(np.float32)
    return stored.astype(np.float32)
