"""Estimates the capture light from the shot itself, if no capture map is given.

Pixels of one chromaticity are assumed to share one albedo; their radiance then varies with the irradiance. It is fitted
as spherical harmonics of bands 0-2, which hold 99 % of any irradiance (Ramamoorthi & Hanrahan 2001). Albedo and light
are determined only up to a factor per channel, so the mean radiance is set to 1 in each: the estimate has the shape of
the light and not its colour. Occlusion and texture look like a weak gradient, so that a weak fit is replaced by the
uniform light.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.envmap import EnvMap, uv_to_direction
from yesnt.relight.harmonics import BANDS, TERMS, basis
from yesnt.relight.points import Surface, gather_pixels

Float = NDArray[np.float64]

_BINS = 32  # per axis of the histogram of chromaticity
_LEAST_SHARE = 0.005  # of all pixels: smaller groups are edges and noise
_STIFFNESS = 0.3  # ridge on bands 1-2, of the mean square: a camera sees half of all normals
_PASSES = 12
_LEAST_GRADIENT = 0.09  # of band 1 over band 0: nearly even lights measured 0.03 and 0.06, directed ones 0.12 or more
_FLOOR = 0.05  # least radiance, of the mean: truncated harmonics ring below 0


def estimate_capture(plates: Sequence[NDArray[np.floating]], surfaces: Sequence[Surface]) -> EnvMap:
    """Fits the capture light of a few frames of a shot.

    Args:
        plates: [H, W, 3] straight scene-linear Rec.709, one per frame.
        surfaces: their G-buffers; normals and opacity are read.

    Returns:
        A 16 x 32 map of mean radiance 1; uniform if the frames do not determine the light.
    """
    colour, normal = _samples(plates, surfaces)
    group = _groups(colour)
    known = group >= 0
    coefficients = np.zeros((TERMS, 3))
    coefficients[0] = 1.0
    if np.count_nonzero(known) > 100:
        fitted = _fit(colour[known], basis(normal[known]), group[known])
        if np.linalg.norm(fitted[1:4]) > _LEAST_GRADIENT * np.sqrt(3):
            coefficients = fitted
    return _map(coefficients)


def _samples(plates: Sequence[NDArray[np.floating]], surfaces: Sequence[Surface]) -> tuple[Float, Float]:
    """Colours [N, 3] and normals [N, 3] of the fully covered pixels that are not black."""
    colours, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for plate, surface in zip(plates, surfaces, strict=True):
        pixels = gather_pixels(surface)
        whole = np.asarray(surface.opacity).reshape(-1)[pixels.index] > 0.99
        values = np.asarray(plate, dtype=np.float64).reshape(-1, 3)[pixels.index][whole]
        good = np.isfinite(values).all(axis=1) & (values.min(axis=1) > 1e-3)
        colours.append(values[good])
        normals.append(pixels.normal[whole][good].astype(np.float64))
    return np.concatenate(colours), np.concatenate(normals)


def _groups(colour: Float) -> NDArray[np.int64]:
    """Group [N] of each colour [N, 3]: the peak of the chromaticity histogram that it climbs to; -1 for small peaks.

    Highlights shift the pixels of a material towards white. Hill climbing keeps them in one group, where the cells of a
    fixed grid would separate them.
    """
    share = colour[:, :2] / np.maximum(colour.sum(axis=1, keepdims=True), 1e-9)
    cell = (np.clip(share, 0, 0.999) * _BINS).astype(np.int64) @ np.array([_BINS, 1])
    count = np.bincount(cell, minlength=_BINS * _BINS)
    steps = np.array([0, 1, -1, *(r * _BINS + c for r in (-1, 1) for c in (-1, 0, 1))])
    around = np.clip(np.arange(_BINS * _BINS)[:, None] + steps, 0, _BINS * _BINS - 1)
    uphill = around[np.arange(len(around)), count[around].argmax(axis=1)]
    for _ in range(_BINS):
        uphill = uphill[uphill]
    _, index, size = np.unique(uphill[cell], return_inverse=True, return_counts=True)
    common = size >= max(_LEAST_SHARE * len(colour), 20)
    return np.where(common, np.cumsum(common) - 1, -1)[index]


def _fit(colour: Float, harmonics: Float, group: NDArray[np.int64]) -> Float:
    """Coefficients [9, 3] of irradiance over its mean; alternates least squares for them and for albedos per group."""
    coefficients = np.zeros((TERMS, 3))
    coefficients[0] = 1 / harmonics[0, 0]
    stiff = _STIFFNESS * np.diag([0.0] + [1.0] * (TERMS - 1))
    size = int(group.max()) + 1
    for _ in range(_PASSES):
        light = np.maximum(harmonics @ coefficients, _FLOOR)
        for k in range(3):
            up = np.bincount(group, colour[:, k] * light[:, k], size)
            albedo = up / np.bincount(group, light[:, k] ** 2, size)
            rows = harmonics * albedo[group][:, None]
            normal = rows.T @ rows
            right = rows.T @ colour[:, k]
            solved = np.linalg.solve(normal + stiff * normal[0, 0], right)
            coefficients[:, k] = solved / max(solved[0] * harmonics[0, 0], 1e-9)
    return coefficients / coefficients[0]


def _map(coefficients: Float) -> EnvMap:
    """Map of mean radiance 1 whose irradiance has the coefficients [9, 3], relative to band 0."""
    direction = uv_to_direction((np.arange(32)[None, :] + 0.5) / 32, (np.arange(16)[:, None] + 0.5) / 16)
    harmonics = basis(direction)
    band = np.repeat(BANDS, [1, 3, 5]) / BANDS[0]
    radiance = harmonics @ (coefficients / band[:, None]) / harmonics[0, 0, 0]
    return EnvMap.from_array(np.maximum(radiance, _FLOOR))
