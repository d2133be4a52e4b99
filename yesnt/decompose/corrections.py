"""Corrects a frame's observed materials before the temporal solve: passes of one quantity, overrides inside masks.

A value that is given has no spread, so its confidence is 1; a factor scales the spread with the value. NumPy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.material_input import Scale
from yesnt.decompose.confidence import LARGEST_STD

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Override:
    """What one entry of `materials:` does to one quantity of a frame.

    Attributes:
        quantity: place in `MATERIAL`.
        change: the value in [0, 1], per frame or pixel [H, W], or a factor on what is there.
        weight: [H, W] in [0, 1], how much of a pixel's subject is changed.
    """

    quantity: int
    change: float | Float32 | Scale
    weight: Float32


@dataclass(frozen=True)
class Corrected:
    """Materials after all corrections.

    Attributes:
        mean: [2, H, W] in [0, 1].
        spread: [2, H, W] in [0, 0.5].
        certain: [2, H, W] in [0, 1], the share of each value that was given.
        clamped: how many scaled values exceeded 1 and were set to 1.
    """

    mean: Float32
    spread: Float32
    certain: Float32
    clamped: int


def correct(mean: Float32, spread: Float32, overrides: Sequence[Override]) -> Corrected:
    """Applies overrides in their order: a later one changes what an earlier one left.

    Args:
        mean: [2, H, W] observed roughness and metallic.
        spread: [2, H, W] their standard deviation.
        overrides: of the frame.
    """
    mean, spread = mean.copy(), spread.copy()
    certain, clamped = np.zeros_like(mean), 0
    for one in overrides:
        q, weight = one.quantity, one.weight
        if isinstance(one.change, Scale):
            factor = 1 + weight * np.float32(one.change.scale - 1)
            scaled = mean[q] * factor
            clamped += int((scaled > 1).sum())
            mean[q] = np.minimum(scaled, 1)
            spread[q] = np.minimum(spread[q] * factor, LARGEST_STD)
        else:
            mean[q] += weight * (np.asarray(one.change, np.float32) - mean[q])
            spread[q] *= 1 - weight
            certain[q] += weight * (1 - certain[q])
    return Corrected(mean, spread, certain, clamped)


def share_of_subject(coverage: Float32, matte: Float32) -> Float32:
    """The share [H, W] of a pixel's subject that a mask covers: the mask's coverage over the matte's.

    At the subject's edge a mask of the whole subject covers as little of a pixel as the subject does; the subject's
    material there is still the mask's alone.

    Args:
        coverage: [H, W] in [0, 1].
        matte: [H, W] in [0, 1].
    """
    visible = np.where(matte > 0, matte, 1)
    return np.where(matte > 0, np.minimum(coverage / visible, 1), 0).astype(np.float32)
