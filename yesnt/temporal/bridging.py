"""Bridges inconsistent frames: their neighbours determine them through the links along the flow.

An inconsistent frame (outliers.py) has confidence near 0. Its links are made stiffer, so that the frames beside it stay
coupled, and its linked pixels lose the spatial term, which would otherwise flatten them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.geometry import drop_spatial_term
from yesnt.temporal.params import EnergyParams, Solution
from yesnt.temporal.solver import check_inputs, solve_inputs

Single = NDArray[np.float32]

BRIDGE = 2.0
"""Weight of fully valid links into and out of an inconsistent frame. The frame has no data of its own; two links of
twice the stiffness in series couple the two frames beside it as strongly as one link of weight 1."""


def bridge(validity: Single) -> Single:
    """Weight of the links of an inconsistent frame: `BRIDGE` times the validity squared.

    A frame without data follows its links however small their weight is, and both of two links in series must be right.
    Squaring the validity accounts for both.
    """
    return (BRIDGE * validity * validity).astype(np.float32)


def bridged_links(validity: Any, frames: tuple[int, ...]) -> Single:
    """Validity [T-1, H, W] with `bridge` around inconsistent frames (`OutlierReport.frames`)."""
    links = np.array(validity, np.float32)
    around = sorted({t for frame in frames for t in (frame - 1, frame) if 0 <= t < len(links)})
    links[around] = bridge(links[around])
    return links


def solve_bridged(
    observed: Any,
    confidence: Any,
    flow: Any,
    validity: Any,
    frames: tuple[int, ...],
    params: EnergyParams,
    matte: Any = None,
    tolerance: float = 1e-4,
) -> Solution:
    """`solve` with inconsistent frames bridged, as a job does it.

    Args:
        observed: [T, H, W] or [C, T, H, W].
        confidence: like observed, or [T, H, W]; lowered by `robust_confidence`.
        flow: [T-1, H, W, 2].
        validity: [T-1, H, W], before `bridged_links`.
        frames: indices of the inconsistent frames (`OutlierReport.frames`). Their links are bridged, and F has no
            spatial term on their linked pixels.
        params: weights of the terms.
        matte: [T, H, W] or None.
        tolerance: relative gap to which F is minimised.

    Returns:
        The minimiser, NumPy float32 like `observed`, and statistics.

    Raises:
        JobError: as `solve`.
    """
    inputs = check_inputs(observed, confidence, flow, bridged_links(validity, frames), matte)
    geometry = inputs.geometry
    for t in frames:
        drop_spatial_term(geometry, t, geometry.link[int(geometry.frames[t]) : int(geometry.frames[t + 1])] > 0)
    solution = solve_inputs(inputs, params, tolerance)
    return Solution(solution.value.reshape(np.shape(observed)), solution.stats)
