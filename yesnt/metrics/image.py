"""Differences of two pictures: PSNR, SSIM, and the per-channel scale that aligns exposures."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

Picture = NDArray[np.floating]
Mask = NDArray[np.bool_]


def mean_squared_error(a: Picture, b: Picture, mask: Mask | None = None) -> float:
    """Mean of (a - b)^2 over pixels (of the mask) and channels, in float64; 0 over no pixels."""
    difference = np.asarray(a, np.float64) - np.asarray(b, np.float64)
    chosen = difference if mask is None else difference[mask]
    return float(np.mean(np.square(chosen))) if chosen.size else 0.0


def decibels(mse: float, peak: float = 1.0) -> float:
    """10 log10(peak^2 / mse); infinite for a mean squared error of 0."""
    return math.inf if mse == 0 else 10 * math.log10(peak**2 / mse)


def psnr(a: Picture, b: Picture, mask: Mask | None = None, peak: float = 1.0) -> float:
    """Peak signal to noise ratio in dB of pictures [..., C] over `mask` [...]."""
    return decibels(mean_squared_error(a, b, mask), peak)


def channel_scale(picture: Picture, truth: Picture, mask: Mask) -> NDArray[np.float64]:
    """The factors [3] that bring a linear picture nearest to the truth: sum(truth x) / sum(x x) over the mask.

    A channel that is black in the picture keeps the factor 1.
    """
    x, g = np.asarray(picture, np.float64)[mask], np.asarray(truth, np.float64)[mask]
    power = np.square(x).sum(axis=0)
    return np.where(power > 0, (x * g).sum(axis=0) / np.where(power > 0, power, 1), 1.0)


def ssim_map(a: Picture, b: Picture) -> NDArray[np.float64]:
    """Structural similarity [H, W], mean over channels, of pictures [H, W, C] in [0, 1] (Wang et al. 2004, eq. 13).

    Gaussian window of standard deviation 1.5, 11 pixels wide, mirrored at the border; population moments; K1 = 0.01 and
    K2 = 0.03.

    Raises:
        ValueError: a side is shorter than the window.
    """
    _, similarity = structural_similarity(
        np.asarray(a, np.float64),
        np.asarray(b, np.float64),
        data_range=1,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    mean: NDArray[np.float64] = similarity.mean(axis=-1)
    return mean
