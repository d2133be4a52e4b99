"""Likelihood of every candidate of roughness and metallic, compiled; `reference.py` states the equations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.settings import (
    DARKEST_METAL,
    METAL_LUMINANCE,
    EvidenceSettings,
    metallic_levels,
)
from yesnt.relight.compiled import exact_entry, exact_kernel
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]

_LEAST_SQUARE = 1e-12  # as in reference.py
_MOST_ERROR = 1e4  # standard deviations
_MOST_PRODUCT = 1e200  # beyond it the logarithm is taken before the next factor
_RED, _GREEN, _BLUE = LUMINANCE_REC709
_MEDIAN, _DEVIATION = METAL_LUMINANCE


def negative_log_likelihood(seen: Observations, of: Responses, settings: EvidenceSettings) -> F32:
    """As `reference.negative_log_likelihood`: [P, R, M] float32; the same bits for any number of threads."""
    count, views = seen.valid.shape
    metallic = metallic_levels(settings)
    out = np.zeros((count, len(of.average), len(metallic)), dtype=np.float32)

    def run(first: int, last: int) -> None:
        scratch = np.empty((4, views)), np.empty(len(metallic))
        robust = Robust(settings.freedom, settings.steps, settings.temper)
        _fit_points(first, last, seen, of, metallic, robust, scratch, out)

    over_ranges(count, run)
    return out


class Robust(NamedTuple):
    """How the fit is weighed (settings.py)."""

    freedom: float
    steps: int
    temper: float


class Candidate(NamedTuple):
    """One channel of one point at one candidate.

    Attributes:
        point: number of the point.
        roughness: number of the level.
        channel: 0 red, 1 green, 2 blue.
        metallic: value.
    """

    point: int
    roughness: int
    channel: int
    metallic: float


@exact_entry
def _fit_points(first, last, seen, of, metallic, robust, scratches, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes minus the log likelihood of points [first, last) to `out`, which is 0. Scratches: [4, V], [M] float64."""
    scratch, luminance = scratches
    views = seen.valid.shape[1]
    for p in range(first, last):
        for r in range(out.shape[1]):
            luminance[:] = 0.0
            for k in range(3):
                used = 0
                for v in range(views):
                    if seen.valid[p, v]:
                        scratch[0, used] = seen.radiance[p, v, k]
                        scratch[1, used] = 1.0 / seen.sigma[p, v, k]
                        used += 1
                for m in range(metallic.shape[0]):
                    candidate = Candidate(p, r, k, metallic[m])
                    cost, base = _fit_channel(candidate, seen.valid, of, robust, used, scratch)
                    out[p, r, m] += cost
                    luminance[m] += (_RED if k == 0 else _GREEN if k == 1 else _BLUE) * base
            if seen.valid[p].any():
                for m in range(metallic.shape[0]):
                    out[p, r, m] += robust.temper * _darkness(metallic[m], luminance[m])


@exact_kernel
def _fit_channel(at, valid, of, robust, used, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Minus the log likelihood of one channel at its best base colour, and that colour.

    `scratch` holds by row: radiance, 1 / sigma, weight, residual. Only valid views are listed.
    """
    nu = robust.freedom
    base = 0.5
    for v in range(used):
        scratch[2, v] = 1.0
    for _ in range(robust.steps):
        compensation = _multiple_scattering(base, of.average[at.roughness])
        up = down = 0.0
        n = 0
        for v in range(valid.shape[1]):
            if valid[at.point, v]:
                slope, offset = _linear_form(at, v, compensation, of)
                w = scratch[2, n] * scratch[1, n] * scratch[1, n] * slope
                up += w * (scratch[0, n] - offset)
                down += w * slope
                n += 1
        base = min(max(up / max(down, _LEAST_SQUARE), 0.0), 1.0)
        _residuals(at, base, valid, of, scratch)
        for v in range(used):
            scratch[2, v] = (nu + 1.0) / (nu + scratch[3, v] * scratch[3, v])
    product, total = 1.0, 0.0
    for v in range(used):
        product *= 1.0 + scratch[3, v] * scratch[3, v] / nu
        if product > _MOST_PRODUCT:
            total += math.log(product)
            product = 1.0
    return 0.5 * (nu + 1.0) * (total + math.log(product)), base


@exact_kernel
def _darkness(metallic, luminance):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """What a dark base colour tells against a metal (reference.darkness)."""
    if luminance >= _MEDIAN:
        return 0.0
    apart = math.log(max(luminance, _LEAST_SQUARE) / _MEDIAN) / _DEVIATION
    return metallic * min(0.5 * apart * apart, DARKEST_METAL)


@exact_kernel
def _residuals(at, base, valid, of, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the residuals in standard deviations to the last row of `scratch`."""
    compensation = _multiple_scattering(base, of.average[at.roughness])
    n = 0
    for v in range(valid.shape[1]):
        if valid[at.point, v]:
            slope, offset = _linear_form(at, v, compensation, of)
            error = (scratch[0, n] - offset - base * slope) * scratch[1, n]
            scratch[3, n] = min(max(error, -_MOST_ERROR), _MOST_ERROR)
            n += 1


@exact_kernel
def _linear_form(at, v, compensation, of):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """A and D of one view, channel and candidate (reference.linear_form)."""
    p, r, k = at.point, at.roughness, at.channel
    metal = at.metallic * (1.0 + compensation * of.missing[p, v, r])
    slope = (1.0 - at.metallic) * of.diffuse[p, v, r, k] + metal * of.metal_f0[p, v, r, k]
    offset = (1.0 - at.metallic) * of.dielectric[p, v, r, k] + metal * of.metal_f90[p, v, r, k]
    return slope, offset


@exact_kernel
def _multiple_scattering(base, average):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fms of a metal of that base colour (relight/albedo.py)."""
    single = base + (1.0 - base) / 21.0
    return single * average / (1.0 - single * (1.0 - average))
