"""Mattes from pictures: what differs from the background, and edges where the picture has them.

Kernels: arrays in, arrays out. Differences are taken in linear light, where a shadow scales the background's colour and
leaves its hue. Min et al. 2014, "Fast Global Image Smoothing Based on Weighted Least Squares"; He et al. 2010, "Guided
Image Filtering".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

SHADOW, LIGHT = 0.5, 1.15
"""Factors between which a background that keeps its hue is only shaded or lit."""

NOISE, FLOOR = 0.04, 0.03
"""Expected deviation of a picture from its background: a share of its radiance, and of the background's mean."""

LEAST_SAMPLES = 3
"""Samples without a person that a pixel of the background needs."""

CERTAIN, SLOPE = 4.0, 1.2
"""Deviations at which a difference is as likely the subject as not, and the slope of the log odds."""

_FREE = 0.3  # probability of a person below which a sample shows the background
_QUIET = (0.25, 4.0)  # limits of the deviation that is measured, as a multiple of the expected one
_TINY = 1e-6
_ROWS = 480.0  # the filters' widths are pixels of a picture of so many rows
_SMOOTH, _COLORS = 30.0, 6.0  # weighted least squares: strength, and levels of 255 that make an edge
_RADIUS, _EDGE_NOISE = 2.0, 1e-3  # guided filter: pixels, squared encoded difference
_VEIL = 0.1  # coverage that the guided filter leaves around an edge


@dataclass(frozen=True)
class Background:
    """A camera's picture without the subject.

    Attributes:
        color: [H, W, 3] linear radiance.
        spread: [H, W] deviation between samples, radiance.
        known: [H, W] bool where it was seen.
    """

    color: F32
    spread: F32
    known: Bool


def clean_background(color: F32) -> Background:
    """The background of a clean plate [H, W, 3]."""
    return Background(color, np.zeros(color.shape[:2], np.float32), np.asarray(np.isfinite(color).all(axis=-1)))


def median_background(samples: NDArray[np.floating], person: NDArray[np.floating] | None = None) -> Background:
    """The temporal median of a camera at rest.

    Args:
        samples: [N, H, W, 3] linear radiance.
        person: [N, H, W] probability that a person is there; such samples do not count. None: all count.
    """
    free = np.asarray(np.isfinite(samples).all(axis=-1))
    if person is not None:
        free &= person < _FREE
    known = free.sum(axis=0) >= min(LEAST_SAMPLES, len(samples))
    counted = np.where((free | ~known)[..., None], samples, np.nan).astype(np.float32)
    color = np.nanmedian(counted, axis=0)
    spread = 1.4826 * np.nanmedian(np.abs(counted - color).max(axis=-1), axis=0)  # of a normal distribution
    return Background(color.astype(np.float32), spread.astype(np.float32), known)


def changed(picture: F32, background: Background) -> F32:
    """Probability [H, W] that a pixel shows something else than the background or its shadow; 0.5 where it is unknown.

    The light may have changed as a whole: the median ratio of picture and background is taken out of each channel.

    Args:
        picture: [H, W, 3] linear radiance.
        background: of the same camera.
    """
    known = background.known & np.isfinite(picture).all(axis=-1)
    if not known.any():
        return np.full(known.shape, 0.5, np.float32)
    picture = np.where(known[..., None], picture, 0)
    base = background.color * _change_of_light(picture[known], background.color[known])
    level = np.maximum(base.mean(axis=-1), 0)
    floor = FLOOR * max(float(level[known].mean()), _TINY)
    scale = (picture * base).sum(axis=-1) / np.maximum((base * base).sum(axis=-1), floor**2)
    off = picture - np.clip(scale, SHADOW, LIGHT)[..., None] * base
    sigma = np.sqrt(np.square(NOISE * level) + floor**2 + np.square(background.spread))
    distance = _blurred(np.sqrt((off * off).sum(axis=-1)) / sigma)
    distance /= np.clip(float(np.median(distance[known])), *_QUIET)
    odds = np.exp(np.clip(SLOPE * (distance - CERTAIN), -30, 30))
    return np.where(known, odds / (1 + odds), 0.5).astype(np.float32)


def _change_of_light(picture: F32, base: F32) -> F32:
    """Factor of each channel between pixels [N, 3] of a picture and of its background."""
    lit = base > FLOOR * max(float(base.mean()), _TINY)
    ratios = [picture[lit[:, c], c] / base[lit[:, c], c] for c in range(3)]
    return np.array([np.median(r) if len(r) else 1.0 for r in ratios], np.float32)


def combined(change: F32, person: F32) -> F32:
    """Probability [H, W] of the subject from both; either may be wrong, so neither counts as certain."""
    log_odds = _log_odds(np.clip(change, 0.05, 0.95)) + _log_odds(np.clip(person, 0.05, 0.95))
    return (1 / (1 + np.exp(-log_odds))).astype(np.float32)


def display_levels(picture: F32) -> U8:
    """A picture [H, W, 3] of linear radiance as 8-bit sRGB, whose edges guide the filters."""
    return (255 * srgb_encode(np.clip(np.nan_to_num(picture), 0, 1)) + 0.5).astype(np.uint8)


def refined(levels: U8, probability: F32) -> F32:
    """The matte [H, W] in [0, 1] whose edges lie where the picture has them.

    Probabilities are spread along smooth regions of the picture, the certain ones most, and cut at one half.

    Args:
        levels: [H, W, 3] as of `display_levels`.
        probability: [H, W] that a pixel shows the subject.
    """
    import cv2

    scale = probability.shape[0] / _ROWS
    certain = np.square(2 * probability - 1) + np.float32(0.01)
    smooth = [
        cv2.ximgproc.fastGlobalSmootherFilter(levels, part.astype(np.float32), _SMOOTH * max(scale, 0.5), _COLORS)
        for part in (certain * probability, certain)
    ]
    return soft_edges(levels, (smooth[0] > 0.5 * smooth[1]).astype(np.float32))


def soft_edges(levels: U8, matte: F32, times: int = 1) -> F32:
    """A matte [H, W] whose edges follow those of its picture within a few pixels.

    Args:
        levels: [H, W, 3] as of `display_levels`.
        matte: [H, W] in [0, 1].
        times: by which it was enlarged.
    """
    import cv2

    radius = times * max(1, round(_RADIUS * matte.shape[0] / times / _ROWS))
    soft = cv2.ximgproc.guidedFilter(levels, matte, radius, 255**2 * _EDGE_NOISE)
    near = cv2.dilate((matte > 0).astype(np.uint8), np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) > 0
    return np.where(near, np.clip((soft - _VEIL) / (1 - 2 * _VEIL), 0, 1), 0).astype(np.float32)


def _blurred(distance: F32) -> F32:
    """Averaged over 3 x 3 pixels: sensor noise differs from pixel to pixel, the subject does not."""
    import cv2

    return np.asarray(cv2.blur(distance.astype(np.float32), (3, 3)))


def _log_odds(probability: F32) -> F32:
    return np.log(probability / (1 - probability))
