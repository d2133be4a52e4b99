"""Pools likelihoods over neighbours of the same surface and appearance: one pixel alone tells too little.

A neighbour's weight falls with its distance in the picture, with the turn of the normal, with its distance to the plane
of the pixel, and with the difference of its appearance in all cameras that see both: colour, intensity, and the pattern
of intensity from camera to camera. Two materials of one colour in the plate differ in that pattern where one of them
mirrors the light. Under a smooth light they hardly differ there; so what the nearest neighbours of each point tell is
compared too, and points that tell different things are not averaged. Single points are too noisy for that: a wrong one
would keep to itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight.compiled import exact_entry, exact_kernel
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

NEAREST = 4
"""Pixels from a point to the farthest of its nearest neighbours."""

_LEAST_WEIGHT = 1e-3  # neighbours below it change nothing


class Neighbourhood(NamedTuple):
    """N points that are neighbours of each other, in rows of the picture.

    Attributes:
        row: [N] row, counted from the first of these points.
        column: [N] column.
        number: [rows, W] number of the point at each place, -1 where there is none.
        cost: [N, K] what is pooled: minus the log likelihood of K candidates.
        color: [N, V, 3] log radiance; per view the mean of the channels is subtracted.
        intensity: [N, V] that mean.
        valid: [N, V] uint8, whether the view saw the point.
        fitted: [N] uint8, whether the cost is known.
        position: [N, 3] world metres.
        normal: [N, 3] unit, world.
        footprint: [N] metres that a pixel covers.
        near: [N, K] the cost pooled over the nearest neighbours; [0, 0] while that is found.
        best: [N] number of its least candidate.
    """

    row: I32
    column: I32
    number: I32
    cost: F32
    color: F32
    intensity: F32
    valid: NDArray[np.uint8]
    fitted: NDArray[np.uint8]
    position: F32
    normal: F32
    footprint: F32
    near: F32
    best: I32


class Widths(NamedTuple):
    """Inverse widths of the weights, and the window (settings.py)."""

    radius: int
    window: float
    chroma: float
    pattern: float
    intensity: float
    turn: float
    apart: float
    contrary: float


def with_nearest(points: Neighbourhood, settings: EvidenceSettings) -> Neighbourhood:
    """The same points with what their nearest neighbours tell."""
    few = replace(settings, radius=NEAREST, window=NEAREST / 2)
    near, weight = pooled(points, range(len(points.row)), few)
    return points._replace(near=near, best=np.where(weight > 0, near.argmin(axis=1), -1).astype(np.int32))


def pooled(points: Neighbourhood, wanted: range, settings: EvidenceSettings) -> tuple[F32, F32]:
    """Weighted mean of the cost over each wanted point's fitted neighbours, [len(wanted), K], and the sum of weights.

    The sum is 0 for a point that no fitted neighbour looks like; its cost is then 0.
    """
    names = ("window", "chroma", "pattern", "intensity", "turn", "apart", "contrary")
    widths = Widths(settings.radius, *(1 / getattr(settings, name) for name in names))
    if not len(points.near):
        widths = widths._replace(contrary=0.0)
    out = np.zeros((len(wanted), points.cost.shape[1]), dtype=np.float32)
    total = np.zeros(len(wanted), dtype=np.float32)
    over_ranges(len(wanted), lambda first, last: _pool(first, last, wanted.start, points, widths, (out, total)))
    return out, total


@exact_entry
def _pool(first, last, offset, points, widths, results):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes pooled cost and sum of weights of points [first, last) after `offset`."""
    out, totals = results
    rows, columns = points.number.shape
    reach = widths.radius
    for i in range(first, last):
        p = offset + i
        total = np.float32(0)
        for y in range(max(points.row[p] - reach, 0), min(points.row[p] + reach + 1, rows)):
            for x in range(max(points.column[p] - reach, 0), min(points.column[p] + reach + 1, columns)):
                q = points.number[y, x]
                if q < 0 or points.fitted[q] == 0:
                    continue
                weight = np.float32(1) if p == q else _weight(p, q, points, widths)
                if weight < _LEAST_WEIGHT:
                    continue
                total += weight
                for k in range(out.shape[1]):
                    out[i, k] += weight * points.cost[q, k]
        totals[i] = total
        if total > 0:
            for k in range(out.shape[1]):
                out[i, k] /= total


@exact_kernel
def _weight(p, q, points, widths):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Weight of neighbour q for point p; 0 if no camera sees both.

    What each of them, with its nearest neighbours, loses at the other's best candidate tells how they contradict.
    """
    down, across = points.row[p] - points.row[q], points.column[p] - points.column[q]
    exponent = (down * down + across * across) * widths.window * widths.window
    along = turn = 0.0
    for k in range(3):
        along += (points.position[q, k] - points.position[p, k]) * points.normal[p, k]
        turn += (points.normal[q, k] - points.normal[p, k]) ** 2
    along *= widths.apart / points.footprint[p]
    exponent += along * along + turn * widths.turn * widths.turn
    if exponent > 14.0:  # exp(-7) is below the least weight
        return np.float32(0)
    shared = 0
    chroma = mean = square = 0.0
    for v in range(points.valid.shape[1]):
        if points.valid[p, v] != 0 and points.valid[q, v] != 0:
            shared += 1
            difference = points.intensity[p, v] - points.intensity[q, v]
            mean += difference
            square += difference * difference
            for k in range(3):
                chroma += (points.color[p, v, k] - points.color[q, v, k]) ** 2
    if shared == 0:
        return np.float32(0)
    mean /= shared
    exponent += chroma / shared * widths.chroma * widths.chroma
    exponent += max(square / shared - mean * mean, 0.0) * widths.pattern * widths.pattern
    exponent += mean * mean * widths.intensity * widths.intensity
    if widths.contrary > 0 and points.best[p] >= 0 and points.best[q] >= 0:
        one, other = points.best[p], points.best[q]
        loss = points.near[p, other] - points.near[p, one] + points.near[q, one] - points.near[q, other]
        exponent += loss * loss * widths.contrary * widths.contrary
    return np.float32(math.exp(-0.5 * exponent))
