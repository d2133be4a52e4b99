"""The evidence in plain NumPy, float64, written as in docs/method.md section 3b: the standard for fit.py."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.settings import (
    DARKEST_METAL,
    METAL_LUMINANCE,
    EvidenceSettings,
    metallic_levels,
)
from yesnt.relight.albedo import multiple_scattering

Float = NDArray[np.floating]

LEAST_SQUARE = 1e-12
"""Smallest denominator of the least squares: a point that no light reaches has base colour 0."""


def negative_log_likelihood(seen: Observations, of: Responses, settings: EvidenceSettings) -> Float:
    """Minus the log likelihood of every candidate, [P, R, M], with the best base colour of each; 0 without a view.

    Student's t distribution: the sum over views and channels of (nu + 1) / 2 log(1 + e^2 / nu), e the residual in
    standard deviations. What a dark base colour tells against a metal is added, times `temper`, since pooled costs are
    divided by it.
    """
    nu, found = settings.freedom, np.zeros((len(seen.valid), len(of.average), len(metallic_levels(settings))))
    for r in range(len(of.average)):
        for m, metallic in enumerate(metallic_levels(settings)):
            base = best_base_color(seen, of, settings, r, metallic)
            error = residual(seen, of, base, r, metallic)
            cost = 0.5 * (nu + 1) * np.log1p(error**2 / nu)
            prior = settings.temper * darkness(metallic, luminance(base)) * seen.valid.any(axis=1)
            found[:, r, m] = (cost * seen.valid[..., None]).sum((1, 2)) + prior
    return found


def darkness(metallic: float, level: Float) -> Float:
    """Minus the log probability of a base colour of luminance `level` [P] over that of a usual one, for a metal.

    Metals that are darker than the median follow a log-normal distribution; nothing is said of brighter ones.
    """
    median, deviation = METAL_LUMINANCE
    apart = np.log(np.maximum(level, LEAST_SQUARE) / median) / deviation
    return np.where(level < median, metallic * np.minimum(0.5 * apart**2, DARKEST_METAL), 0.0)


def best_base_color(seen: Observations, of: Responses, settings: EvidenceSettings, r: int, metallic: float) -> Float:
    """Base colour [P, 3] in [0, 1], b = sum w A (y - D) / sum w A^2, reweighted by the residuals."""
    valid, inverse = seen.valid[..., None], 1 / seen.sigma.astype(float) ** 2
    base: Float = np.full((len(seen.valid), 3), 0.5)
    weight: Float = np.ones(seen.radiance.shape)
    for _ in range(settings.steps):
        slope, offset = linear_form(of, base, r, metallic)
        w = valid * weight * inverse
        b = (w * slope * (seen.radiance - offset)).sum(1) / np.maximum((w * slope**2).sum(1), LEAST_SQUARE)
        base = np.clip(b, 0, 1)
        weight = (settings.freedom + 1) / (settings.freedom + residual(seen, of, base, r, metallic) ** 2)
    return base


def linear_form(of: Responses, base: Float, r: int, metallic: float) -> tuple[Float, Float]:
    """A and D [P, V, 3] of one candidate; the compensation of metals is taken at the last base colour."""
    single = base + (1 - base) / 21  # mean of Schlick's Fresnel
    factor = 1 + multiple_scattering(single, np.asarray(of.average[r]))[:, None] * of.missing[:, :, r, None]
    slope = (1 - metallic) * of.diffuse[:, :, r] + metallic * factor * of.metal_f0[:, :, r]
    offset = (1 - metallic) * of.dielectric[:, :, r] + metallic * factor * of.metal_f90[:, :, r]
    return slope, offset


def residual(seen: Observations, of: Responses, base: Float, r: int, metallic: float) -> Float:
    """(y - D - b A) / sigma [P, V, 3]."""
    slope, offset = linear_form(of, base, r, metallic)
    return np.asarray((seen.radiance - offset - base[:, None] * slope) / seen.sigma)
