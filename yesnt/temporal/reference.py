"""NumPy reference of the temporal energy in float64, written as in the paper; slow.

    F(x) = sum c H_delta(x~ - x) + lambda1 sum sqrt((Dx x)^2 + (Dy x)^2 + eps^2) + lambda2 sum V ((W x_{t+1}) - x_t)^2

(paper, Temporal Consistency; details in docs/method.md section 4). Arrays are dense `[T, H, W]`. The fast kernels list
matte pixels only and are tested against this module.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.params import EnergyParams

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def huber(residual: Array, delta: float) -> Array:
    """H_delta(r): r^2 / 2 up to delta, linear above."""
    size = np.abs(residual)
    return np.where(size <= delta, 0.5 * residual**2, delta * (size - 0.5 * delta))


def forward_differences(x: Array, matte: Mask) -> tuple[Array, Array]:
    """(Dx x, Dy x) of `[T, H, W]`: 0 at the last column or row and across the matte's border."""
    dx, dy = np.zeros_like(x), np.zeros_like(x)
    dx[:, :, :-1] = np.where(matte[:, :, 1:] & matte[:, :, :-1], x[:, :, 1:] - x[:, :, :-1], 0.0)
    dy[:, :-1, :] = np.where(matte[:, 1:, :] & matte[:, :-1, :], x[:, 1:, :] - x[:, :-1, :], 0.0)
    return dx, dy


def warp(image: Array, flow: Array, matte: Mask) -> tuple[Array, Mask]:
    """Backward warp W of one frame: `image` bilinearly sampled at p + flow(p), over matte pixels only.

    Args:
        image: [H, W] frame t+1.
        flow: [H, W, 2] pixels (dx, dy) from t to t+1.
        matte: [H, W] of frame t+1.

    Returns:
        [H, W] samples, and where they are valid: inside [0, W-1] x [0, H-1] with at least half of the bilinear weight
        on matte pixels. The weights are renormalised to sum to 1.
    """
    height, width = image.shape
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    x, y = columns + flow[..., 0], rows + flow[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    total, weight_sum = np.zeros_like(x), np.zeros_like(x)
    for row, row_weight in ((y0, 1 - (y - y0)), (y0 + 1, y - y0)):
        for column, column_weight in ((x0, 1 - (x - x0)), (x0 + 1, x - x0)):
            r, c = np.minimum(row, height - 1), np.minimum(column, width - 1)
            weight = row_weight * column_weight * matte[r, c]
            total += weight * np.where(matte[r, c], image[r, c], 0.0)
            weight_sum += weight
    valid = inside & (weight_sum >= 0.5)
    return np.where(valid, total / np.where(valid, weight_sum, 1.0), 0.0), valid


def energy_terms(
    x: Array, observed: Array, confidence: Array, flow: Array, validity: Array, params: EnergyParams, matte: Mask
) -> tuple[float, float, float]:
    """The data, spatial and temporal term of F, including their weights; arrays as in docs/method.md section 4."""
    dx, dy = forward_differences(x, matte)
    data = float(np.sum((confidence * huber(observed - x, params.delta))[matte]))
    space = params.lambda1 * float(np.sum(np.sqrt(dx**2 + dy**2 + params.eps**2)[matte]))
    time = 0.0
    for t in range(len(x) - 1):
        sampled, valid = warp(x[t + 1], flow[t], matte[t + 1])
        weight = validity[t] * (valid & matte[t])
        time += float(np.sum(weight * np.where(valid, sampled - x[t], 0.0) ** 2))
    return data, space, params.lambda2 * time
