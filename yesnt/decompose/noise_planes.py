"""Noise of one ensemble member over the whole frame, at several spatial scales."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from yesnt.core.noise import noise_field

Float32 = NDArray[np.float32]


def ensemble_noise(
    key: tuple[int, int, int], size: tuple[int, int], sigmas: tuple[float, ...], paired: bool
) -> Float32:
    """Returns the noise of a member, [len(sigmas), H, W].

    Args:
        key: (job seed, frame, member).
        size: rows and columns.
        sigmas: Gaussian blur in pixels per plane, 0 for white noise.
        paired: an odd member has the negated field of the even member before it.
    """
    seed, frame, member = key
    if not paired:
        return member_noise(key, *size, sigmas)
    planes = member_noise((seed, frame, member - member % 2), *size, sigmas)
    return np.negative(planes, out=planes) if member % 2 else planes


def member_noise(key: tuple[int, int, int], height: int, width: int, sigmas: tuple[float, ...]) -> Float32:
    """Returns standard normal planes of one member, which patches crop.

    With white noise only, neighbouring patches would choose the material of a garment independently, and blending would
    reduce the spread. Smooth planes of one field over the frame correlate their choices.

    Args:
        key: (job seed, frame, member).
        height: rows.
        width: columns.
        sigmas: Gaussian blur in pixels per plane, 0 for white noise.

    Returns:
        [len(sigmas), H, W] float32, every value N(0, 1). The blur is periodic, so the field is stationary up to the
        border.
    """
    seed, frame, member = key
    planes = noise_field(seed, frame, member, height, width, len(sigmas))
    for plane, sigma in zip(planes, sigmas, strict=True):
        if sigma > 0:
            plane[...] = _blurred_to_unit_variance(plane, sigma)
    return planes


def _blurred_to_unit_variance(plane: Float32, sigma: float) -> Float32:
    height, width = plane.shape
    rows = np.exp(-2 * (np.pi * sigma * scipy.fft.fftfreq(height)) ** 2)
    columns = np.exp(-2 * (np.pi * sigma * scipy.fft.fftfreq(width)) ** 2)
    # Parseval: white noise of variance 1 keeps the mean of the squared transfer function as its variance.
    gain = 1 / np.sqrt(np.mean(rows**2) * np.mean(columns**2))
    spectrum = scipy.fft.rfft2(plane)
    spectrum *= (gain * rows[:, None]).astype(np.float32)
    spectrum *= columns[None, : spectrum.shape[1]].astype(np.float32)
    blurred: Float32 = scipy.fft.irfft2(spectrum, s=plane.shape, overwrite_x=True)
    return blurred
