"""Parts of the set in front of the subject: how much of a pixel they cover, and their part of its light.

Source: docs/method.md section 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, uniform_filter

F32 = NDArray[np.float32]

TOLERANCE = 0.02
"""Metres by which the set must be nearer than the subject: a sole touches the ground that it stands on."""

REACH = 6
"""Pixels beyond the subject's border to which its z is extended, so that an edge there is known on both sides."""

_FILTER_WIDTH = 1.5  # pixels: of the Blackman-Harris filter with which Cycles renders a plate
_MIN_WEIGHT = 0.02  # of a neighbourhood: below it nothing pure lies there, and the plate's own colour stands


def holdout_coverage(depth: F32, z: F32, opacity: F32) -> F32:
    """Coverage [H, W] of the set's pieces that are nearer than the subject, with the soft edges of a rendered plate.

    Args:
        depth: [n H, n W] planar metres of the set through n by n points of each pixel.
        z: [H, W] planar metres of the subject, 0 on a miss.
        opacity: [H, W] of the subject.

    Returns:
        In [0, 1]; 0 farther than `REACH` pixels from the subject, where there is no z to compare with.
    """
    factor = depth.shape[0] // z.shape[0]
    extended, near = _extended(z, (opacity > 0) & (z > 0))
    nearer = depth < np.repeat(np.repeat(extended - TOLERANCE, factor, axis=0), factor, axis=1)
    return np.where(near, _filtered(nearer.astype(np.float32), factor), 0).astype(np.float32)


def _extended(z: F32, known: NDArray[np.bool_]) -> tuple[F32, NDArray[np.bool_]]:
    """Z of the nearest known pixel, and where that is at most `REACH` pixels away."""
    if not known.any():
        return z, known
    distance, nearest = distance_transform_edt(~known, return_indices=True)
    return z[tuple(nearest)], distance <= REACH


def _filtered(points: F32, factor: int) -> F32:
    """Pixels [H, W] of points [n H, n W] under Cycles' pixel filter."""
    offset, weight = _taps(factor)
    reach = max(-offset[0], offset[-1])
    padded = np.pad(points, reach, mode="edge")
    taps = list(zip(offset, weight, strict=True))
    rows = np.sum([w * padded[o + reach :: factor][: points.shape[0] // factor] for o, w in taps], axis=0)
    both = np.sum([w * rows[:, o + reach :: factor][:, : points.shape[1] // factor] for o, w in taps], axis=0)
    return np.clip(both, 0, 1).astype(np.float32)


def _taps(factor: int) -> tuple[list[int], list[float]]:
    """Points of a line that the filter of a pixel reads, counted from its first, and their weights, which sum to 1."""
    offset = [o for o in range(-factor, 2 * factor) if abs((o + 0.5) / factor - 0.5) < _FILTER_WIDTH / 2]
    phase = 2 * np.pi * (((np.array(offset) + 0.5) / factor - 0.5) / _FILTER_WIDTH + 0.5)
    weight = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    return offset, (weight / weight.sum()).tolist()


def split_front(plate: F32, holdout: F32) -> tuple[F32, F32]:
    """The light of what is in front of the subject, and the straight radiance of what is behind it.

    A pixel of which the pieces cover the part h shows `plate = h F + (1 - h) B`. F and B are the means of the
    neighbours that show one of them alone; what is left of the plate goes to both by their shares.

    Args:
        plate: [H, W, 3] radiance.
        holdout: [H, W] in [0, 1].

    Returns:
        h F and B, [H, W, 3] each; `h F + (1 - h) B` is the plate.
    """
    h = holdout[..., None].astype(np.float64)
    front, back = (_pure(plate, np.where(h == full, 1.0, 0.0)) for full in (1, 0))
    left = (plate - h * front - (1 - h) * back) / (h * h + (1 - h) * (1 - h))
    light = np.clip(h * (front + h * left), 0, plate)
    behind = np.where(h < 1, (plate - light) / np.where(h < 1, 1 - h, 1), plate)
    return np.where(h == 1, plate, light).astype(np.float32), behind.astype(np.float32)


def _pure(plate: F32, weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the neighbours that have a weight [H, W, 1], in the smallest window that holds enough of them."""
    out, done = plate.astype(np.float64), np.zeros(plate.shape[:2], np.bool_)
    for size in (3, 5, 9):
        share = uniform_filter(weight[..., 0], size, mode="nearest")
        total = np.stack([uniform_filter(weight[..., 0] * plate[..., k], size, mode="nearest") for k in range(3)], -1)
        new = ~done & (share > _MIN_WEIGHT)
        out[new] = total[new] / share[new][:, None]
        done |= new
    return out
