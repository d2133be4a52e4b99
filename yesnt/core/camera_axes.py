"""Camera axes and units of other programs, converted to OpenCV's axes and metres; what a pose must be."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError

F64 = NDArray[np.float64]

AXES = MappingProxyType({"opencv": (1.0, 1.0, 1.0), "opengl": (1.0, -1.0, -1.0), "blender": (1.0, -1.0, -1.0)})
"""Signs of OpenCV's x, y, z in the axes of a camera: OpenGL's and Blender's look along -z with +y up.

The axes are the camera's own. The world stays as it is: right-handed, Z up.
"""

UNITS = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001})
"""Metres of one unit of length."""

ROTATION_TOLERANCE = 1e-3
"""Largest error of R R' - I: cameras come from files with float32 or 5-digit text."""

_LAST = [0.0, 0.0, 0.0, 1.0]
_IDENTITY = np.eye(3)


def opencv_pose(values: Any, where: str, axes: str = "opencv", units: str = "m") -> F64:
    """`world_from_camera` [4, 4] in OpenCV axes and metres.

    Args:
        values: 16 numbers, row-major, or [4, 4].
        where: names the pose in errors.
        axes: the camera's axes in the values, a key of `AXES`.
        units: unit of the translation, a key of `UNITS`.

    Raises:
        JobError: not 16 finite numbers, or not a right-handed rotation and a translation; says what is wrong.
    """
    matrix = _matrix(values, where)
    if problem := _problem(matrix):
        raise JobError(
            f"A camera pose is not a rotation and a translation: {problem}", where,
            "`world_from_camera`: a right-handed 4x4, row-major, without scale, last row 0 0 0 1", "export it again",
        )  # fmt: skip
    pose = matrix.copy()
    pose[:3, :3] *= AXES[axes]
    pose[:3, 3] *= UNITS[units]
    pose.setflags(write=False)
    return pose


def _matrix(values: Any, where: str) -> F64:
    try:
        matrix = np.asarray(values, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError) as error:
        raise JobError(
            "A camera pose cannot be read", where, '{"world_from_camera": [16 numbers, row-major]}', "correct it"
        ) from error
    if not np.isfinite(matrix).all():
        raise JobError("A camera pose has NaN or infinite numbers", where, "16 finite numbers", "export it again")
    return matrix


def _problem(matrix: F64) -> str:
    """What is wrong with a pose; empty if nothing is."""
    rotation, last = matrix[:3, :3], matrix[3]
    if last.tolist() != _LAST and not np.allclose(last, _LAST, rtol=0, atol=1e-6):
        if np.allclose(matrix[:, 3], _LAST, rtol=0, atol=1e-6):
            return "it is column-major (the translation stands in the last row); write its transpose"
        return f"its last row is {' '.join(f'{v:g}' for v in last)}"
    off = float(np.abs(rotation @ rotation.T - _IDENTITY).max())
    if off > ROTATION_TOLERANCE:
        lengths = np.linalg.norm(rotation, axis=0)
        scaled = lengths.min() > 0 and np.ptp(lengths) < ROTATION_TOLERANCE * lengths.max()
        if scaled and abs(lengths[0] - 1) > ROTATION_TOLERANCE:
            return f"it is scaled by {lengths.mean():g}"
        return f"its axes are not orthonormal (R R' differs from the identity by {off:.3g})"
    return "it is left-handed (a mirrored axis)" if np.linalg.det(rotation) < 0 else ""
