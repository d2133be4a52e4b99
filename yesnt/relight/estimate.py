"""A guess of the light that a plate was shot under, from the shot itself, for when no capture map is given.

Pixels of one chromaticity are taken to share one albedo; what then varies with the normal is irradiance. It is fitted
as spherical harmonics of bands 0-2, which hold 99 % of any irradiance (Ramamoorthi & Hanrahan 2001). Albedo and light
are known only up to a factor per channel, so the mean radiance is set to 1 in each: the guess holds its shape, not
its colour. Occlusion and texture look like a weak gradient: a weak fit is given up for the uniform light.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.envmap import EnvMap, uv_to_direction
from yesnt.relight.harmonics import BANDS, TERMS, basis
from yesnt.relight.points import Surface, gather_pixels

Float = NDArray[np.float64]

_BINS = 32  # of each chromaticity
_LEAST_SHARE = 0.005  # of the pixels: smaller groups are edges and noise
_STIFFNESS = 0.3  # of the mean square, on bands 1-2: a camera sees half of all normals, the rest must not run away
_PASSES = 12
_LEAST_GRADIENT = 0.09  # of band 1 over band 0: nearly even lights fitted 0.03 and 0.06, directed ones 0.12 and more
_FLOOR = 0.05  # of the mean radiance: truncated harmonics ring below 0


def estimate_capture(plates: Sequence[NDArray[np.floating]], surfaces: Sequence[Surface]) -> EnvMap:
    """Fits the light of a few frames of a shot.

    Args:
        plates: [H, W, 3] straight scene-linear, one a frame.
        surfaces: their normals and opacity; materials are not used.

    Returns:
        A 16 x 32 map of mean radiance 1; uniform where the frames hold too little to tell.
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
    """Number of the peak of the chromaticity histogram that each pixel climbs to, -1 for small peaks.

    Highlights pull a material's pixels towards white; climbing keeps them with it where a fixed grid would part them.
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
    """Alternates albedos [G, 3] and coefficients [9, 3] of irradiance over its mean; both steps are least squares."""
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
    """Radiance 1 on average whose irradiance has these coefficients relative to band 0."""
    direction = uv_to_direction((np.arange(32)[None, :] + 0.5) / 32, (np.arange(16)[:, None] + 0.5) / 16)
    harmonics = basis(direction)
    band = np.repeat(BANDS, [1, 3, 5]) / BANDS[0]
    radiance = harmonics @ (coefficients / band[:, None]) / harmonics[0, 0, 0]
    return EnvMap.from_array(np.maximum(radiance, _FLOOR))
