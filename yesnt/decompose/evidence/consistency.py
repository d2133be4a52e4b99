"""Finds cameras that contradict the others: wrong pose, wrong exposure, black pictures, another subject's matte.

Every camera implies a base colour at a point: for a dielectric of middle roughness b = (y - D) / A. Cameras should
agree about it. The median over many points of one camera's b over the median of all cameras is its gain; the scatter of
that ratio tells whether it looks at the same points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.decompose.evidence.observe import Sample
from yesnt.decompose.evidence.records import Responses

Float = NDArray[np.floating]

NEUTRAL = 0.5
"""Roughness of the dielectric that cameras are compared by."""

LEAST_OVERLAP = 0.7
"""Overlap of the proxy's silhouette and a matte below which they show different things; coarse proxies reach 0.9."""

MOST_GAIN = 1.4
"""Ratio to the other cameras from which a picture has another exposure; half a stop. Metals stay below it."""

_LEAST_POINTS = 50  # points that a camera must share with others before it is compared
_LEAST_VIEWS = 3  # two cameras that differ do not tell which of them is wrong
_MOST_SCATTER = 0.6  # standard deviation of log2 ratios beyond which a camera looks elsewhere ...
_TIMES_SCATTER = 3.0  # ... if it is also so many times that of the other cameras
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


def agreement(samples: Sequence[Sample], of: Responses) -> Agreement:
    """Compares V cameras over P points; `of` holds one roughness, `NEUTRAL`."""
    radiance = luminance(np.stack([one.radiance for one in samples], axis=1).astype(np.float64))
    valid = np.stack([one.valid for one in samples], axis=1)
    valid &= valid.sum(axis=1, keepdims=True) >= _LEAST_VIEWS
    slope, offset = (luminance(a[:, :, 0].astype(np.float64)) for a in (of.diffuse, of.dielectric))
    implied = np.where(valid, np.maximum(radiance - offset, 1e-4) / np.maximum(slope, 1e-3), np.nan)
    gain, scatter = np.full(len(samples), np.nan), np.full(len(samples), np.nan)
    seen = valid.any(axis=1)
    if not seen.any():
        return Agreement(gain, scatter)
    ratio = np.log2(implied[seen] / np.nanmedian(implied[seen], axis=1, keepdims=True))
    for v in np.flatnonzero(valid.sum(axis=0) >= _LEAST_POINTS):
        one = ratio[:, v][valid[seen, v]]
        middle = np.median(one)
        gain[v], scatter[v] = 2**middle, 1.4826 * np.median(np.abs(one - middle))
    return Agreement(gain, scatter)


def contradictions(names: Sequence[str], found: Agreement) -> dict[str, str]:
    """Camera -> why it contradicts the others, for those that do."""
    known = found.scatter[np.isfinite(found.scatter)]
    usual = float(np.median(known)) if len(known) else 0.0
    reasons = {}
    for name, gain, scatter in zip(names, found.gain, found.scatter, strict=True):
        if gain < _BLACK:
            reasons[name] = "its picture is black where the others see the subject"
        elif gain > MOST_GAIN or gain < 1 / MOST_GAIN:
            reasons[name] = f"its picture is {gain:.2f} times as bright as the others' (state its `gain`)"
        elif scatter > max(_MOST_SCATTER, _TIMES_SCATTER * usual):
            reasons[name] = (
                f"its picture differs from the others' by {scatter:.1f} stops from point to point: wrong pose"
            )
    return reasons


def silhouette_contradiction(overlap: float, shown: float) -> str | None:
    """Why a camera's matte contradicts the proxy (observe.silhouette_overlap), or None."""
    if shown == 0:
        return "it does not see the subject"
    if overlap < LEAST_OVERLAP:
        return f"its matte covers {100 * overlap:.0f} % of what the proxy shows there: wrong pose, frame or matte"
    return None
