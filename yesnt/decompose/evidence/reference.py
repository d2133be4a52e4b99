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


MOST_TURN = 2.0
"""Standard deviations by which a normal is turned at most: the responses are linear in the turn for a small one."""

Turned = tuple[Responses, Responses]


def negative_log_likelihood(
    seen: Observations, of: Responses, settings: EvidenceSettings, turned: Turned | None = None
) -> Float:
    """Minus the log likelihood of every candidate, [P, R, M], with the best base colour of each; 0 without a view.

    Student's t distribution: the sum over views and channels of (nu + 1) / 2 log(1 + e^2 / nu), e the residual in
    standard deviations. What a dark base colour tells against a metal is added, times `temper`, since pooled costs are
    divided by it.

    Args:
        seen: what V cameras saw of P points.
        of: responses at the normals.
        settings: of the evidence.
        turned: responses at normals turned about two axes by one standard deviation of their error each. The turn is
            then an unknown too, shared by the neighbours that a point is pooled with: what it costs counts `temper`.
    """
    nu, found = settings.freedom, np.zeros((len(seen.valid), len(of.average), len(metallic_levels(settings))))
    for r in range(len(of.average)):
        for m, metallic in enumerate(metallic_levels(settings)):
            base, turn, weight = _fitted(seen, of, settings, (r, metallic), turned)
            error = _error(seen, of, (base, turn), (r, metallic), turned) / seen.sigma
            cost = (0.5 * (nu + 1) * np.log1p(error**2 / nu) * seen.valid[..., None]).sum((1, 2))
            prior = darkness(metallic, luminance(base))
            if turned is not None:
                curvature, _ = _normal_equations(seen, of, (base, turn), (r, metallic), turned, weight)
                prior += turn_cost(turn, curvature, settings)
            found[:, r, m] = cost + settings.temper * prior * seen.valid.any(axis=1)
    return found


def turn_cost(turn: Float, curvature: Float, settings: EvidenceSettings) -> Float:
    """Minus the log probability of a turn [P, 2] of N(0, 1), and log of how precisely the views ask it to be set [P].

    The second term is Laplace's approximation of the integral over all turns; `curvature` is J'WJ [P, 2, 2].
    """
    return 0.5 * (turn**2).sum(-1) + 0.5 * np.log(np.linalg.det(np.eye(2) + curvature / settings.temper))


def darkness(metallic: float, level: Float) -> Float:
    """Minus the log probability of a base colour of luminance `level` [P] over that of a usual one, for a metal.

    Metals that are darker than the median follow a log-normal distribution; nothing is said of brighter ones.
    """
    median, deviation = METAL_LUMINANCE
    apart = np.log(np.maximum(level, LEAST_SQUARE) / median) / deviation
    return np.where(level < median, metallic * np.minimum(0.5 * apart**2, DARKEST_METAL), 0.0)


def best_base_color(seen: Observations, of: Responses, settings: EvidenceSettings, r: int, metallic: float) -> Float:
    """Base colour [P, 3] in [0, 1], b = sum w A (y - D) / sum w A^2, reweighted by the residuals."""
    return _fitted(seen, of, settings, (r, metallic), None)[0]


def _fitted(
    seen: Observations, of: Responses, settings: EvidenceSettings, at: tuple[int, float], turned: Turned | None
) -> tuple[Float, Float, Float]:
    """Base colour [P, 3], turn [P, 2] and the last weights [P, V, 3], found in turns."""
    valid, inverse = seen.valid[..., None], 1 / seen.sigma.astype(float) ** 2
    base: Float = np.full((len(seen.valid), 3), 0.5)
    turn, weight = np.zeros((len(base), 2)), np.ones(seen.radiance.shape) * valid
    for _ in range(settings.steps):
        slope, offset = linear_form(of, base, *at)
        if turned is not None:
            forms = [linear_form(one, base, *at) for one in turned]
            slope = slope + sum(t[:, None, None] * (f[0] - slope) for t, f in zip(turn.T, forms, strict=True))
            offset = offset + sum(t[:, None, None] * (f[1] - offset) for t, f in zip(turn.T, forms, strict=True))
        w = weight * inverse
        b = (w * slope * (seen.radiance - offset)).sum(1) / np.maximum((w * slope**2).sum(1), LEAST_SQUARE)
        base = np.clip(b, 0, 1)
        if turned is not None:
            curvature, right = _normal_equations(seen, of, (base, turn), at, turned, weight)
            solved = np.linalg.solve(curvature + settings.temper * np.eye(2), right[..., None])[..., 0]
            turn = np.clip(solved, -MOST_TURN, MOST_TURN)
        error = _error(seen, of, (base, turn), at, turned) / seen.sigma
        weight = valid * (settings.freedom + 1) / (settings.freedom + error**2)
    return base, turn, weight


def _normal_equations(
    seen: Observations, of: Responses, found: tuple[Float, Float], at: tuple[int, float], turned: Turned, weight: Float
) -> tuple[Float, Float]:
    """J'WJ [P, 2, 2] and J'We [P, 2] of the turn, J = b (A' - A) + D' - D, e the error without a turn."""
    base, _ = found
    w = weight / seen.sigma.astype(float) ** 2
    turns = np.stack(_changes(of, base, at, turned), axis=-1)
    error = _error(seen, of, (base, np.zeros((len(base), 2))), at, None)
    return np.einsum("pvk,pvki,pvkj->pij", w, turns, turns), np.einsum("pvk,pvki,pvk->pi", w, turns, error)


def _changes(of: Responses, base: Float, at: tuple[int, float], turned: Turned) -> list[Float]:
    """Change of the expected radiance [P, V, 3] with each of the two turns."""
    plain = expected(of, base, *at)
    return [expected(one, base, *at) - plain for one in turned]


def _error(
    seen: Observations, of: Responses, found: tuple[Float, Float], at: tuple[int, float], turned: Turned | None
) -> Float:
    """Observed less expected radiance [P, V, 3]."""
    base, turn = found
    error = seen.radiance - expected(of, base, *at)
    if turned is not None:
        error = error - sum(
            t[:, None, None] * one for t, one in zip(turn.T, _changes(of, base, at, turned), strict=True)
        )
    return np.asarray(error)


def expected(of: Responses, base: Float, r: int, metallic: float) -> Float:
    """Radiance b A + D [P, V, 3]."""
    slope, offset = linear_form(of, base, r, metallic)
    return np.asarray(base[:, None] * slope + offset)


def linear_form(of: Responses, base: Float, r: int, metallic: float) -> tuple[Float, Float]:
    """A and D [P, V, 3] of one candidate; the compensation of metals is taken at the last base colour."""
    single = base + (1 - base) / 21  # mean of Schlick's Fresnel
    factor = 1 + multiple_scattering(single, np.asarray(of.average[r]))[:, None] * of.missing[:, :, r, None]
    slope = (1 - metallic) * of.diffuse[:, :, r] + metallic * factor * of.metal_f0[:, :, r]
    offset = (1 - metallic) * of.dielectric[:, :, r] + metallic * factor * of.metal_f90[:, :, r]
    return slope, offset
