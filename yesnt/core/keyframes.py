"""Values given at some frames: linear between them, each number for itself, constant outside them.

This is what Nuke and Blender do with linear keys and constant extrapolation: a turn from 0 to 350 degrees passes
through 175, and does not take the shorter way back.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Numbers = tuple[float, float, float]


def number_at(value: float | Mapping[int, float], frame: int) -> float:
    """The number of a frame: one for all frames, or by frame number, at least one."""
    if not isinstance(value, Mapping):
        return value
    frames = sorted(value)
    return float(np.interp(frame, frames, [value[key] for key in frames]))


def numbers_at(value: Numbers | Mapping[int, Numbers], frame: int) -> Numbers:
    """The three numbers of a frame, as `number_at`."""
    if not isinstance(value, Mapping):
        return value
    x, y, z = (number_at({key: numbers[axis] for key, numbers in value.items()}, frame) for axis in range(3))
    return x, y, z
