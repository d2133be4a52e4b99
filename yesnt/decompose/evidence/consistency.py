"""Finds cameras that contradict the others: wrong pose, wrong exposure, black pictures, another subject's matte.

At some points the best candidate is fitted to all cameras, and each camera's radiance is compared with what the fit
predicts for it. The median of that ratio over the points, relative to the other cameras, is the camera's gain; its
scatter tells whether the camera looks at the same points. The fit explains highlights and mirrors, so that a metal is
not taken for a camera of another exposure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.decompose.evidence.fit import negative_log_likelihood
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.reference import best_base_color, linear_form
from yesnt.decompose.evidence.settings import EvidenceSettings, metallic_levels

Float = NDArray[np.floating]

LEVELS = (0.1, 0.25, 0.5, 0.85)
"""Roughness levels that are fitted; fewer than for the materials, since only the prediction matters."""

LEAST_OVERLAP = 0.7
"""Overlap of the proxy's silhouette and a matte below which they show different things; coarse proxies reach 0.9."""

MOST_GAIN = 1.4
"""Ratio to the other cameras from which a picture has another exposure; half a stop."""

_LEAST_POINTS = 50  # points that a camera must share with others before it is compared
_LEAST_VIEWS = 3  # two cameras that differ do not tell which of them is wrong
_MOST_SCATTER = 0.6  # standard deviation of log2 ratios beyond which a camera looks elsewhere ...
_TIMES_SCATTER = 3.0  # ... if it is also so many times that of the other cameras
_DARK = 1e-4  # radiance that a logarithm is taken of, at least
_BLACK = 0.02  # gain below which a picture is black


@dataclass(frozen=True)
class Agreement:
    """How V cameras agree.

    Attributes:
        gain: [V] radiance over that of the others; NaN: too few points to tell.
        scatter: [V] robust standard deviation of the log2 ratio; NaN as well.
    """

    gain: Float
    scatter: Float


def agreement(seen: Observations, of: Responses, settings: EvidenceSettings) -> Agreement:
    """Compares V cameras over P points.

    Args:
        seen: what they saw.
        of: responses for `LEVELS` of roughness.
        settings: of the evidence.
    """
    valid = seen.valid & (seen.valid.sum(axis=1, keepdims=True) >= _LEAST_VIEWS)
    views = valid.shape[1]
    gain, scatter = np.full(views, np.nan), np.full(views, np.nan)
    shared = valid.any(axis=1)
    if not shared.any():
        return Agreement(gain, scatter)
    radiance, expected = (luminance(a.astype(np.float64)) for a in (seen.radiance, _predicted(seen, of, settings)))
    ratio = np.where(valid, np.log2(np.maximum(radiance, _DARK) / np.maximum(expected, _DARK)), np.nan)[shared]
    ratio -= np.nanmedian(ratio, axis=1, keepdims=True)
    for v in np.flatnonzero(valid.sum(axis=0) >= _LEAST_POINTS):
        one = ratio[:, v][valid[shared, v]]
        middle = np.median(one)
        gain[v], scatter[v] = 2**middle, 1.4826 * np.median(np.abs(one - middle))
    return Agreement(gain, scatter)


def _predicted(seen: Observations, of: Responses, settings: EvidenceSettings) -> Float:
    """Radiance [P, V, 3] of each point's best candidate."""
    cost = negative_log_likelihood(seen, of, settings)
    best = cost.reshape(len(cost), -1).argmin(axis=1)
    expected = np.zeros(seen.radiance.shape)
    metallic = metallic_levels(settings)
    for candidate in np.unique(best):
        level, m = divmod(int(candidate), len(metallic))
        these = best == candidate
        part = Observations(*(a[these] for a in seen))
        lobes = Responses(
            of.diffuse[these], of.dielectric[these], of.metal_f0[these], of.metal_f90[these], of.missing[these],
            of.average,
        )  # fmt: skip
        base = best_base_color(part, lobes, settings, level, metallic[m])
        slope, offset = linear_form(lobes, base, level, metallic[m])
        expected[these] = base[:, None] * slope + offset
    return expected


def left_out_views(
    names: Sequence[str], seen: Observations, of: Responses, settings: EvidenceSettings
) -> tuple[dict[str, str], dict[str, float]]:
    """Camera -> why it is left out, and the gain of every camera that can be compared.

    One camera at a time, the worst first: while it takes part it disturbs what the fit predicts for the others.

    Args:
        names: of the V cameras.
        seen: what they saw of P points.
        of: responses for `LEVELS` of roughness.
        settings: of the evidence.
    """
    seen, reasons, gains = seen._replace(valid=seen.valid.copy()), dict[str, str](), dict[str, float]()
    while True:
        found = agreement(seen, of, settings)
        gains |= {n: round(float(g), 3) for n, g in zip(names, found.gain, strict=True) if np.isfinite(g)}
        worst = _worst(found)
        if worst is None:
            return reasons, gains
        reasons[names[worst[0]]] = worst[1]
        seen.valid[:, worst[0]] = False


def _worst(found: Agreement) -> tuple[int, str] | None:
    """Number of the camera that contradicts the others most, and how; None if none does.

    Exposure comes first: a wrong one scatters too, where few cameras see a point.
    """
    apart = np.nan_to_num(np.abs(np.log2(np.maximum(found.gain, _DARK))))
    worst = int(apart.argmax())
    if apart[worst] > np.log2(MOST_GAIN):
        gain = found.gain[worst]
        if gain < _BLACK:
            return worst, "its picture is black where the others see the subject"
        return worst, f"its picture is {gain:.2f} times as bright as the others' (state its `gain`)"
    known = found.scatter[np.isfinite(found.scatter)]
    scatter, worst = np.nan_to_num(found.scatter), int(np.nan_to_num(found.scatter).argmax())
    if len(known) and scatter[worst] > max(_MOST_SCATTER, _TIMES_SCATTER * float(np.median(known))):
        return worst, f"its picture differs from the others' by {scatter[worst]:.1f} stops, point by point: wrong pose"
    return None


def silhouette_contradiction(overlap: float, shown: float) -> str | None:
    """Why a camera's matte contradicts the proxy (observe.silhouette_overlap), or None."""
    if shown == 0:
        return "it does not see the subject"
    if overlap < LEAST_OVERLAP:
        return f"its matte covers {100 * overlap:.0f} % of what the proxy shows there: wrong pose, frame or matte"
    return None
