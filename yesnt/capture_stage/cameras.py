"""Camera paths of the stage, in OpenCV axes over a Z-up world (method.md section 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]


def look_at(position: ArrayLike, target: ArrayLike) -> Matrix:
    """`world_from_camera` [4, 4] of an upright camera: +x right, +y down, +z towards the target.

    Raises:
        ValueError: the view is straight up or down, where "upright" says nothing.
    """
    position, target = np.asarray(position, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-6:
        raise ValueError(f"the view from {position} to {target} is vertical")
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    out[:3, 3] = position
    return out


def orbit(degrees: float, distance: float, height: float, target: ArrayLike) -> Matrix:
    """A camera on a circle about the target's axis; 0 degrees looks along +Y (at the face), positive goes to +X."""
    target = np.asarray(target, dtype=np.float64)
    angle = np.radians(degrees)
    offset = np.array([np.sin(angle) * distance, -np.cos(angle) * distance, 0.0])
    return look_at([target[0] + offset[0], target[1] + offset[1], height], target)
