"""Evaluates a smooth function of the pixels at few of them and interpolates where these agree.

Every n-th pixel of every n-th row is evaluated; then follow the pixels half way between them, and so on. A pixel takes
the mean of its four neighbours where these lie on one surface and agree, else it is evaluated itself. The caller names
pixels where the function may have smaller details: all of these are evaluated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.points import Pixels

F32 = NDArray[np.float32]
Places = NDArray[np.intp]

_SAME_WAY, _LEAN = 0.97, 0.3  # of two pixels of one surface: cosine of their normals; rise over distance, at most


def interpolated(
    pixels: Pixels,
    evaluate: Callable[[Places], F32],
    tolerance: float,
    spacing: int,
    detailed: NDArray[np.bool_] | None = None,
) -> F32:
    """Values [P, K] of pixels.

    Args:
        pixels: P pixels.
        evaluate: values [N, K] of pixels [N].
        tolerance: by how much neighbours may differ that agree.
        spacing: rows and columns between the pixels that are evaluated first, a power of 2.
        detailed: [P] pixels that are evaluated in any case; None: no others.
    """
    row, column = np.divmod(pixels.index, pixels.shape[1])
    number = np.full((pixels.shape[0] + 2 * spacing, pixels.shape[1] + 2 * spacing), -1, dtype=np.int64)
    number[row + spacing, column + spacing] = np.arange(len(row))
    done = (row % spacing == 0) & (column % spacing == 0)
    if detailed is not None:
        done |= detailed
    first = evaluate(np.flatnonzero(done))
    values = np.zeros((len(row), first.shape[1]), dtype=np.float32)
    values[done] = first
    step, flat = spacing // 2, _flat(pixels)
    while step >= 1:
        level = np.flatnonzero((row % step == 0) & (column % step == 0) & ~done)
        down, across = (step * (axis[level] // step % 2) for axis in (row, column))
        sides = [
            number[row[level] + spacing + s * down, column[level] + spacing + t * across]
            for s in (-1, 1)
            for t in (-1, 1)
        ]
        agreed = _agree(level, sides, values, tolerance)
        if not flat:
            agreed &= _one_surface(pixels, level, sides)
        taken, asked = level[agreed], level[~agreed]
        values[taken] = sum(values[side[agreed]] for side in sides) / np.float32(4)
        values[asked] = evaluate(asked)
        done[level] = True
        step //= 2
    return values


def _agree(level: Places, sides: list[NDArray[np.int64]], values: F32, tolerance: float) -> NDArray[np.bool_]:
    """Where [L] all neighbours are there and have values alike."""
    there = np.all([side >= 0 for side in sides], axis=0)
    low = high = values[sides[0]]
    for side in sides[1:]:
        low, high = np.minimum(low, values[side]), np.maximum(high, values[side])
    return there & ((high - low).max(axis=1) <= tolerance)


def _flat(pixels: Pixels) -> bool:
    """Whether all pixels lie in one plane."""
    normal, position = pixels.normal, pixels.position
    if not len(normal) or not (normal == normal[0]).all():
        return False
    above = (position - position[0]) @ normal[0]
    return float(np.abs(above).max()) <= 1e-5 * float(np.abs(position).max())


def _one_surface(pixels: Pixels, level: Places, sides: list[NDArray[np.int64]]) -> NDArray[np.bool_]:
    """Where [L] all neighbours lie on the pixel's surface."""
    good = np.ones(len(level), dtype=np.bool_)
    for side in sides:
        apart = pixels.position[side] - pixels.position[level]
        rise = np.abs((apart * pixels.normal[level]).sum(axis=1))
        good &= (pixels.normal[side] * pixels.normal[level]).sum(axis=1) > _SAME_WAY
        good &= rise <= _LEAN * np.linalg.norm(apart, axis=1) + 1e-6
    return good
