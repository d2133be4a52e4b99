"""Frames and members whose prediction is strongly inconsistent: found by robust statistics, trusted less, reported.

Such predictions are the paper's own limitation: a least-squares coupling in time would smear them over their
neighbours. A frame is compared with what its neighbours predict for it along the flow: the residual from the median of
up to five values (the frame itself and two frames to each side) is large where the frame is alone with its opinion, and
stays small in the clean frames next to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.flow import box_mean
from yesnt.temporal.geometry import Geometry
from yesnt.temporal.solver import check_inputs

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]

REACH = 2
"""Frames on each side that predict a frame."""

WINDOW = 4
"""Frames on each side whose residuals tell what is usual."""

OUTLIER_HALO = REACH + WINDOW
"""Halo with which a block gives the same confidence as the whole sequence."""


@dataclass(frozen=True)
class OutlierSettings:
    """What counts as inconsistent.

    Attributes:
        limit: residual over usual residual above which trust falls, as (limit / ratio)^4: a
            frame far off is worth no more than a missing one.
        usual_floor: smallest usual residual, so that a noiseless sequence does not condemn rounding.
        region: side of the box over which residuals are averaged, pixels; single pixels are Huber's affair.
    """

    limit: float = 5.0
    usual_floor: float = 0.01
    region: int = 15


@dataclass(frozen=True)
class OutlierReport:
    """What was found, per frame of the input.

    Attributes:
        ratio: [T] the frame's median residual over the usual one, worst channel.
        distrusted: [T] share of the frame's matte pixels whose confidence was at least halved, worst channel.
        frames: indices of the frames that are inconsistent as a whole (ratio above the limit).
    """

    ratio: tuple[float, ...]
    distrusted: tuple[float, ...]
    frames: tuple[int, ...]


def robust_confidence(
    observed: Any,
    confidence: Any,
    flow: Any,
    validity: Any,
    matte: Any,
    settings: OutlierSettings | None = None,
) -> tuple[Single, OutlierReport]:
    """Lowers the confidence of inconsistent frames and regions; arrays as in `solve`.

    Args:
        observed: [T, H, W] or [C, T, H, W].
        confidence: like observed, or [T, H, W].
        flow: [T-1, H, W, 2].
        validity: [T-1, H, W].
        matte: [T, H, W] or None.
        settings: None for the defaults.

    Returns:
        confidence float32 of the shape of `observed`, and the report. With `OUTLIER_HALO` frames around a block the
        block's frames get the same values as in the whole sequence.
    """
    settings = settings or OutlierSettings()
    inputs = check_inputs(observed, confidence, flow, validity, matte)
    result = inputs.confidence.copy()
    ratios, shares = [], []
    for channel, planes in enumerate(inputs.observed):
        residual = track_residuals(planes[inputs.matte], inputs.geometry)
        weights, ratio = _trust(residual, inputs.matte, inputs.geometry, settings)
        result[channel] *= weights
        ratios.append(ratio)
        shares.append(
            [float(np.mean(w[m] < 0.5)) if m.any() else 0.0 for w, m in zip(weights, inputs.matte, strict=True)]
        )
    worst, share = np.max(ratios, axis=0), np.max(shares, axis=0)
    frames = tuple(int(t) for t in np.flatnonzero(worst > settings.limit))
    report = OutlierReport(tuple(map(float, worst)), tuple(map(float, share)), frames)
    return result.reshape(np.shape(observed)), report


def track_residuals(values: Single, geometry: Geometry) -> Single:
    """|value - median of the value and its predictions along the flow| of each pixel [N].

    0 where fewer than two predictions reach the pixel: with one, nobody can tell who is wrong.
    """
    rows = [values]
    for predict in (_predict_from_next, _predict_from_previous):
        predicted = values
        for _ in range(REACH):
            predicted = predict(predicted, geometry)
            rows.append(predicted)
    stack = np.sort(np.stack(rows), axis=0)  # NaN, for "no prediction", sorts to the end
    count = np.sum(~np.isnan(stack), axis=0)
    lower = np.take_along_axis(stack, (count - 1)[None] // 2, axis=0)[0]
    upper = np.take_along_axis(stack, count[None] // 2, axis=0)[0]
    return np.where(count >= 3, np.abs(values - 0.5 * (lower + upper)), 0.0).astype(np.float32)


def _corners(geometry: Geometry) -> list[tuple[NDArray[np.uint32], Single]]:
    indices = (geometry.top, geometry.top + 1, geometry.bottom, geometry.bottom + 1)
    return [(index, geometry.weights[:, k]) for k, index in enumerate(indices)]


def _predict_from_next(values: Single, geometry: Geometry) -> Single:
    """W values: what frame t+1 says about frame t; NaN where no valid link leads."""
    total = np.zeros(len(values), np.float32)
    for index, weight in _corners(geometry):
        total += np.where(weight > 0, weight * values[np.minimum(index, len(values) - 1)], 0.0)
    return np.where(geometry.link > 0.5, total, np.nan)


def _predict_from_previous(values: Single, geometry: Geometry) -> Single:
    """W^T values over W^T 1: what frame t-1 says about frame t; NaN where less than half a pixel arrives."""
    total, count = np.zeros(len(values)), np.zeros(len(values))
    known = (geometry.link > 0.5) & ~np.isnan(values)
    for index, weight in _corners(geometry):
        used = known & (weight > 0)
        total += np.bincount(index[used], weight[used] * values[used].astype(np.float64), len(values))
        count += np.bincount(index[used], weight[used].astype(np.float64), len(values))
    return np.where(count > 0.5, total / np.maximum(count, 0.5), np.nan).astype(np.float32)


def _trust(
    residual: Single, matte: Mask, geometry: Geometry, settings: OutlierSettings
) -> tuple[Single, NDArray[np.float64]]:
    """Weight [T, H, W] in [0, 1] of each pixel and the frames' ratios [T]."""
    frames = geometry.frames
    parts = [residual[frames[t] : frames[t + 1]] for t in range(len(matte))]
    medians = np.array([float(np.median(part)) if len(part) else 0.0 for part in parts])
    weights, ratios = np.ones(matte.shape, np.float32), np.zeros(len(matte))
    for t, part in enumerate(parts):
        window = medians[max(0, t - WINDOW) : t + WINDOW + 1]
        usual = max(float(np.median(window)), settings.usual_floor)
        ratios[t] = medians[t] / usual
        dense = np.zeros(matte.shape[1:], np.float32)
        dense[matte[t]] = part
        local = np.maximum(box_mean(dense, matte[t], settings.region) / usual, ratios[t])
        weights[t] = np.minimum(1.0, (settings.limit / np.maximum(local, settings.limit)) ** 4)
    return weights, ratios


def consistent_members(
    members: NDArray[np.floating], matte: Mask, limit: float = 4.0
) -> tuple[Mask, NDArray[np.float64]]:
    """Which members of one frame's ensemble agree with the others.

    Args:
        members: [K, H, W] predictions of one frame.
        matte: [H, W].
        limit: distance from the members' median over the median of these distances, above which a member is left out.

    Returns:
        [K] bool kept (all of them for K < 3, since two cannot outvote one another) and [K] distances: median over the
        matte of |member - median of members|.
    """
    inside = np.asarray(members)[:, matte]
    if inside.shape[1] == 0:
        return np.ones(len(inside), bool), np.zeros(len(inside))
    distance = np.median(np.abs(inside - np.median(inside, axis=0)), axis=1).astype(np.float64)
    if len(inside) < 3:
        return np.ones(len(inside), bool), distance
    return distance <= limit * max(float(np.median(distance)), 0.0025), distance
