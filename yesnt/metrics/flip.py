"""FLIP: the error that a viewer sees when two pictures alternate (Andersson et al. 2020), and its HDR form (2021).

All filters are sums of separable Gaussians or their derivatives, so every pass is one-dimensional.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from yesnt.core.color import luminance, srgb_decode

Picture = NDArray[np.floating]
Float = NDArray[np.float64]

PIXELS_PER_DEGREE = 3840 * math.pi / 180
"""67.02: a screen of 3840 pixels as wide as it is far away (0.7 m), the paper's default."""

_CSF = {"A": ((1.0, 0.0047), (0.0, 1e-5)), "RG": ((1.0, 0.0053), (0.0, 1e-5)), "BY": ((34.1, 0.04), (13.5, 0.025))}
"""Contrast sensitivity of achromatic, red-green and blue-yellow: (a, b) of two Gaussians (2020, table 1)."""

_COLOR_POWER, _KNEE_IN, _KNEE_OUT = 0.7, 0.4, 0.95  # q_c, p_c, p_t of the paper
_FEATURE_POWER, _FEATURE_WIDTH = 0.5, 0.082  # q_f and w of the paper, w in degrees
_ACES = (0.36 * 2.51, 0.6 * 0.03, 0.36 * 2.43, 0.6 * 0.59, 0.14)  # Narkowicz's fit, exposed by 0.6
_TONE_MAX = 0.85  # tone-mapped value that the brightest exposure gives to the median, the darkest to the maximum

_RGB_TO_XYZ = np.array(
    [[0.41239080, 0.35758434, 0.18048079], [0.21263901, 0.71516868, 0.07219232], [0.01933082, 0.11919478, 0.95053215]]
)
_WHITE = _RGB_TO_XYZ.sum(axis=1)


def flip_map(display: Picture, truth: Picture, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Float:
    """Error [H, W] in [0, 1] of two sRGB-encoded pictures [H, W, 3] in [0, 1]."""
    a, b = (srgb_decode(np.asarray(picture, float)).astype(float) for picture in (display, truth))
    return _flip_linear(a, b, pixels_per_degree)


def hdr_flip_map(
    radiance: Picture, truth: Picture, exposures: Sequence[float], pixels_per_degree: float = PIXELS_PER_DEGREE
) -> Float:
    """Largest FLIP [H, W] over tone-mapped exposures (in stops) of two scene-linear pictures [H, W, 3] >= 0."""
    worst = np.zeros(np.asarray(truth).shape[:2])
    for stops in exposures:
        a, b = (_tone_map(np.asarray(p, float) * 2.0**stops) for p in (radiance, truth))
        np.maximum(worst, _flip_linear(a, b, pixels_per_degree), out=worst)
    return worst


def exposure_range(truth: Picture) -> tuple[float, ...]:
    """Exposures for HDR-FLIP from the truth's pixels [..., 3]: from where its maximum shows to where its median does.

    Evenly spaced, one a stop or denser, at least two (2021, section 4). Pixels must not all be black.
    """
    light = luminance(np.asarray(truth, float)).reshape(-1)
    a, b, c, d, e = _ACES
    # The x whose tone-mapped value is _TONE_MAX: (a x^2 + b x) = t (c x^2 + d x + e).
    quadratic, linear, constant = a - _TONE_MAX * c, b - _TONE_MAX * d, -_TONE_MAX * e
    x = (-linear + math.sqrt(linear**2 - 4 * quadratic * constant)) / (2 * quadratic)
    top = float(light.max())
    middle = np.partition(light, light.size // 2)[light.size // 2]  # of two middle values the upper, as the authors
    median = max(float(middle), 1e-6 * top)  # a picture that is mostly black has no median to show
    start, stop = math.log2(x / top), math.log2(x / median)
    count = max(2, math.ceil(stop - start))
    return tuple(float(s) for s in np.linspace(start, stop, count))


def _flip_linear(a: Float, b: Float, ppd: float) -> Float:
    color = _redistribute(_color_distance(_filtered(a, ppd), _filtered(b, ppd)))
    feature = _feature_difference(_opponent(a)[..., 0], _opponent(b)[..., 0], ppd)
    error: Float = color ** (1 - feature)
    return error


def _opponent(linear: Float) -> Float:
    """Linear Rec.709 [..., 3] to YCxCz."""
    x, y, z = np.moveaxis(linear @ _RGB_TO_XYZ.T / _WHITE, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _filtered(linear: Float, ppd: float) -> Float:
    """What the eye resolves: contrast-sensitivity filter in YCxCz; back to linear, clipped to the gamut."""
    opponent = _opponent(linear)
    planes = [_sensitivity(opponent[..., i], _CSF[name], ppd) for i, name in enumerate(("A", "RG", "BY"))]
    y = (planes[0] + 16) / 116
    xyz = np.stack([y + planes[1] / 500, y, y - planes[2] / 200], axis=-1) * _WHITE
    return np.clip(xyz @ np.linalg.inv(_RGB_TO_XYZ).T, 0, 1)


def _sensitivity(plane: Float, terms: tuple[tuple[float, float], ...], ppd: float) -> Float:
    widest = max(b for pair in _CSF.values() for _, b in pair)
    radius = math.ceil(3 * math.sqrt(widest / (2 * math.pi**2)) * ppd)
    degrees = np.arange(-radius, radius + 1) / ppd
    total, norm = np.zeros_like(plane), 0.0
    for a, b in terms:
        if a == 0:
            continue
        window = np.exp(-(math.pi**2) * degrees**2 / b)
        gain = a * math.sqrt(math.pi / b)
        total += gain * _separable(plane, window, window)
        norm += gain * float(window.sum()) ** 2
    return total / norm


def _separable(plane: Float, along_x: Float, along_y: Float) -> Float:
    """Correlates columns with one window and rows with another; the border repeats."""
    result: Float = correlate1d(correlate1d(plane, along_x, axis=1, mode="nearest"), along_y, axis=0, mode="nearest")
    return result


def _color_distance(a: Float, b: Float) -> Float:
    """HyAB distance of Hunt-adjusted CIELAB, to the power q_c."""
    difference = np.abs(_hunt_lab(a) - _hunt_lab(b))
    distance: Float = (difference[..., 0] + np.hypot(difference[..., 1], difference[..., 2])) ** _COLOR_POWER
    return distance


def _hunt_lab(linear: Float) -> Float:
    """CIELAB whose chroma shrinks with lightness: colours in the dark differ less (Hunt effect)."""
    ratio = linear @ _RGB_TO_XYZ.T / _WHITE
    knee = 6 / 29
    f = np.where(ratio > knee**3, np.cbrt(ratio), ratio / (3 * knee**2) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    a, b = 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])
    return np.stack([lightness, 0.01 * lightness * a, 0.01 * lightness * b], axis=-1)


def _redistribute(distance: Float) -> Float:
    """Maps [0, largest distance of the gamut] to [0, 1], most of it to small errors (2020, section 4.1.3)."""
    corners = np.eye(3)[1:]
    largest = float(_color_distance(corners[:1], corners[1:])[0])
    knee = _KNEE_IN * largest
    low = _KNEE_OUT / knee * distance
    high = _KNEE_OUT + (distance - knee) / (largest - knee) * (1 - _KNEE_OUT)
    return np.clip(np.where(distance < knee, low, high), 0, 1)


def _feature_difference(a: Float, b: Float, ppd: float) -> Float:
    """Difference of edges and points in lightness planes [H, W] (2020, section 4.2)."""
    differences = [np.abs(x - y) for x, y in zip(_features(a, ppd), _features(b, ppd), strict=True)]
    return np.clip((np.maximum(*differences) / math.sqrt(2)) ** _FEATURE_POWER, 0, 1)


def _features(plane: Float, ppd: float) -> tuple[Float, Float]:
    """Strength of edges and of points [H, W]: first and second derivatives of a Gaussian."""
    sigma = 0.5 * _FEATURE_WIDTH * ppd
    radius = math.ceil(3 * sigma)
    x = np.arange(-radius, radius + 1)
    bell = np.exp(-0.5 * (x / sigma) ** 2)
    smooth = bell / bell.sum()
    grey = (plane + 16) / 116
    strengths = []
    for window in (-x * bell, ((x / sigma) ** 2 - 1) * bell):
        balanced = np.where(window > 0, window / window[window > 0].sum(), window / -window[window < 0].sum())
        strengths.append(np.hypot(_separable(grey, balanced, smooth), _separable(grey, smooth, balanced)))
    return strengths[0], strengths[1]


def _tone_map(linear: Float) -> Float:
    """Narkowicz's fit of the ACES curve, clipped to [0, 1]."""
    a, b, c, d, e = _ACES
    mapped: Float = np.clip((a * linear**2 + b * linear) / (c * linear**2 + d * linear + e), 0, 1)
    return mapped
