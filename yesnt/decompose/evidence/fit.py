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
MOST_TURN = 2.0  # as in reference.py
_MOST_ERROR = 1e4  # standard deviations
_MOST_PRODUCT = 1e200  # beyond it the logarithm is taken before the next factor
_RED, _GREEN, _BLUE = LUMINANCE_REC709
_MEDIAN, _DEVIATION = METAL_LUMINANCE


def negative_log_likelihood(
    seen: Observations, of: Responses, settings: EvidenceSettings, turned: tuple[Responses, Responses] | None = None
) -> F32:
    """As `reference.negative_log_likelihood`: [P, R, M] float32; the same bits for any number of threads."""
    count, views = seen.valid.shape
    metallic = metallic_levels(settings)
    out = np.zeros((count, len(of.average), len(metallic)), dtype=np.float32)
    lobes = Lobes(of, *(turned or (of, of)))
    robust = Robust(settings.freedom, settings.steps, settings.temper, turned is not None)

    def run(first: int, last: int) -> None:
        _fit_points(first, last, seen, lobes, metallic, robust, np.empty((_ROWS, 3 * views)), out)

    over_ranges(count, run)
    return out


class Robust(NamedTuple):
    """How the fit is weighed (settings.py); `turns` says whether the normal is an unknown of it."""

    freedom: float
    steps: int
    temper: float
    turns: bool


class Lobes(NamedTuple):
    """Responses at the normal, and at the normal turned about two axes."""

    at: Responses
    first: Responses
    second: Responses


class Candidate(NamedTuple):
    """A candidate at one point: numbers of the point and of the level of roughness, value of metallic."""

    point: int
    roughness: int
    metallic: float


# Rows of the scratch: one column for each valid view and channel.
_RADIANCE, _INVERSE, _WEIGHT, _RESIDUAL, _SLOPE, _OFFSET = range(6)
_SLOPE_1, _OFFSET_1, _SLOPE_2, _OFFSET_2 = range(6, 10)  # differences that the turns make
_ROWS = 10


@exact_entry
def _fit_points(first, last, seen, lobes, metallic, robust, scratch, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes minus the log likelihood of points [first, last) to `out`. Scratch: [_ROWS, 3 V] float64."""
    views = seen.valid.shape[1]
    for p in range(first, last):
        used = 0
        for v in range(views):
            if seen.valid[p, v]:
                for k in range(3):
                    scratch[_RADIANCE, used] = seen.radiance[p, v, k]
                    scratch[_INVERSE, used] = 1.0 / seen.sigma[p, v, k]
                    used += 1
        if used == 0:
            continue
        for r in range(out.shape[1]):
            for m in range(metallic.shape[0]):
                at = Candidate(p, r, metallic[m])
                out[p, r, m] = _fit(at, seen.valid, lobes, robust, scratch[:, :used])


@exact_kernel
def _fit(at, valid, lobes, robust, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Minus the log likelihood of one candidate at its best base colour and turn of the normal."""
    nu, used = robust.freedom, scratch.shape[1]
    red = green = blue = 0.5
    turn = 0.0, 0.0
    scratch[_WEIGHT] = 1.0
    _forms(at, valid, lobes, (red, green, blue), robust.turns, scratch)
    for _ in range(robust.steps):
        red, green, blue = (
            _base_color(0, turn, scratch), _base_color(1, turn, scratch), _base_color(2, turn, scratch),
        )  # fmt: skip
        base = red, green, blue
        _forms(at, valid, lobes, base, robust.turns, scratch)
        if robust.turns:
            turn = _best_turn(base, robust.temper, scratch)
        for i in range(used):
            error = (scratch[_RADIANCE, i] - _expected(base[i % 3], turn, i, scratch)) * scratch[_INVERSE, i]
            error = min(max(error, -_MOST_ERROR), _MOST_ERROR)
            scratch[_RESIDUAL, i] = error
            scratch[_WEIGHT, i] = (nu + 1.0) / (nu + error * error)
    cost = 0.5 * (nu + 1.0) * _log_sum(nu, scratch)
    luminance = _RED * red + _GREEN * green + _BLUE * blue
    cost += robust.temper * _darkness(at.metallic, luminance)
    if robust.turns:
        cost += robust.temper * _turn_cost((red, green, blue), turn, robust.temper, scratch)
    return cost


@exact_kernel
def _log_sum(nu, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Sum of log(1 + e^2 / nu); few logarithms of products."""
    product, total = 1.0, 0.0
    for i in range(scratch.shape[1]):
        product *= 1.0 + scratch[_RESIDUAL, i] * scratch[_RESIDUAL, i] / nu
        if product > _MOST_PRODUCT:
            total += math.log(product)
            product = 1.0
    return total + math.log(product)


@exact_kernel
def _base_color(k, turn, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Best base colour in [0, 1] of channel k."""
    up = down = 0.0
    for i in range(k, scratch.shape[1], 3):
        slope = scratch[_SLOPE, i] + turn[0] * scratch[_SLOPE_1, i] + turn[1] * scratch[_SLOPE_2, i]
        offset = scratch[_OFFSET, i] + turn[0] * scratch[_OFFSET_1, i] + turn[1] * scratch[_OFFSET_2, i]
        w = scratch[_WEIGHT, i] * scratch[_INVERSE, i] * scratch[_INVERSE, i] * slope
        up += w * (scratch[_RADIANCE, i] - offset)
        down += w * slope
    return min(max(up / max(down, _LEAST_SQUARE), 0.0), 1.0)


@exact_kernel
def _expected(base, turn, i, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Radiance that a base colour and a turn predict for a column of the scratch."""
    first = base * scratch[_SLOPE_1, i] + scratch[_OFFSET_1, i]
    second = base * scratch[_SLOPE_2, i] + scratch[_OFFSET_2, i]
    return base * scratch[_SLOPE, i] + scratch[_OFFSET, i] + turn[0] * first + turn[1] * second


@exact_kernel
def _curvature(base, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """J'WJ of the two turns (11, 12, 22) and J'We of the unturned error (1, 2)."""
    a = b = c = d = e = 0.0
    for i in range(scratch.shape[1]):
        w = scratch[_WEIGHT, i] * scratch[_INVERSE, i] * scratch[_INVERSE, i]
        first = base[i % 3] * scratch[_SLOPE_1, i] + scratch[_OFFSET_1, i]
        second = base[i % 3] * scratch[_SLOPE_2, i] + scratch[_OFFSET_2, i]
        error = scratch[_RADIANCE, i] - base[i % 3] * scratch[_SLOPE, i] - scratch[_OFFSET, i]
        a += w * first * first
        b += w * first * second
        c += w * second * second
        d += w * first * error
        e += w * second * error
    return a, b, c, d, e


@exact_kernel
def _best_turn(base, temper, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Turn of largest probability, in standard deviations of the error of normals (reference.best_turn)."""
    a, b, c, d, e = _curvature(base, scratch)
    a += temper
    c += temper
    norm = a * c - b * b
    first, second = (c * d - b * e) / norm, (a * e - b * d) / norm
    return min(max(first, -MOST_TURN), MOST_TURN), min(max(second, -MOST_TURN), MOST_TURN)


@exact_kernel
def _turn_cost(base, turn, temper, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """What the turn costs, and how precisely it must be set (reference.turn_cost)."""
    a, b, c, _, _ = _curvature(base, scratch)
    a, b, c = 1.0 + a / temper, b / temper, 1.0 + c / temper
    return 0.5 * (turn[0] * turn[0] + turn[1] * turn[1]) + 0.5 * math.log(a * c - b * b)


@exact_kernel
def _darkness(metallic, luminance):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """What a dark base colour tells against a metal (reference.darkness)."""
    if luminance >= _MEDIAN:
        return 0.0
    apart = math.log(max(luminance, _LEAST_SQUARE) / _MEDIAN) / _DEVIATION
    return metallic * min(0.5 * apart * apart, DARKEST_METAL)


@exact_kernel
def _forms(at, valid, lobes, base, turns, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes A and D of every valid view and channel, and their differences for both turns."""
    i = 0
    for v in range(valid.shape[1]):
        if not valid[at.point, v]:
            continue
        for k in range(3):
            compensation = _multiple_scattering(base[k], lobes.at.average[at.roughness])
            slope, offset = _linear_form(at, v, k, compensation, lobes.at)
            scratch[_SLOPE, i], scratch[_OFFSET, i] = slope, offset
            if turns:
                first = _linear_form(at, v, k, compensation, lobes.first)
                second = _linear_form(at, v, k, compensation, lobes.second)
                scratch[_SLOPE_1, i], scratch[_OFFSET_1, i] = first[0] - slope, first[1] - offset
                scratch[_SLOPE_2, i], scratch[_OFFSET_2, i] = second[0] - slope, second[1] - offset
            else:
                scratch[_SLOPE_1:, i] = 0.0
            i += 1


@exact_kernel
def _linear_form(at, v, k, compensation, of):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """A and D of one view, channel and candidate (reference.linear_form)."""
    p, r = at.point, at.roughness
    metal = at.metallic * (1.0 + compensation * of.missing[p, v, r])
    slope = (1.0 - at.metallic) * of.diffuse[p, v, r, k] + metal * of.metal_f0[p, v, r, k]
    offset = (1.0 - at.metallic) * of.dielectric[p, v, r, k] + metal * of.metal_f90[p, v, r, k]
    return slope, offset


@exact_kernel
def _multiple_scattering(base, average):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fms of a metal of that base colour (relight/albedo.py)."""
    single = base + (1.0 - base) / 21.0
    return single * average / (1.0 - single * (1.0 - average))
