"""Detects inconsistent frames, regions and ensemble members by robust statistics and lowers their confidence.

The paper names strongly inconsistent predictions as its limitation: the quadratic temporal term would spread them over
the neighbouring frames. Each pixel is compared with the values that neighbouring frames predict for it along the flow.
Its residual is the distance from the median of up to five values: its own and those of two frames on each side. The
residual is large where one frame disagrees with all others and stays small in the clean frames next to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.flow import box_mean
from yesnt.temporal.solver import check_inputs
from yesnt.temporal.tracks import REACH, ObservedFrame, Tracks

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]

WINDOW = 4
"""Frames on each side from whose residuals the usual residual is estimated."""

MEDIAN_OF_MEAN = 0.845
"""Median over mean of the absolute value of a normal variable."""

OUTLIER_HALO = REACH + WINDOW
"""Frames of halo with which a block gets the same confidence as the whole sequence."""


@dataclass(frozen=True)
class OutlierSettings:
    """Thresholds of the outlier detection.

    Attributes:
        limit: ratio of residual to usual residual above which the confidence is multiplied by (limit / ratio)^4, so
            that a frame far above it has the weight of a missing one.
        usual_floor: lower bound of the usual residual, in units of the material; without it, rounding errors would
            count as outliers in a noiseless sequence.
        region: side in pixels of the box over which residuals are averaged. The Huber term handles single pixels.
    """

    limit: float = 5.0
    usual_floor: float = 0.01
    region: int = 15


@dataclass(frozen=True)
class OutlierReport:
    """Result of the outlier detection, per frame of the input.

    Attributes:
        ratio: [T] median residual of the frame over the usual residual, worst channel.
        downweighted: [T] share of the frame's matte pixels whose confidence was at least halved, worst channel.
        frames: indices of the frames that are inconsistent as a whole (ratio above the limit).
    """

    ratio: tuple[float, ...]
    downweighted: tuple[float, ...]
    frames: tuple[int, ...]


@dataclass(frozen=True)
class FrameConsistency:
    """Consistency of one frame with its neighbours.

    Attributes:
        weight: [C, H, W] factor in [0, 1] for the confidence.
        ratio: median residual of the frame over the usual residual, worst channel.
        downweighted: share of the frame's matte pixels whose weight is below one half, worst channel.
    """

    weight: Single
    ratio: float
    downweighted: float


def robust_confidence(
    observed: Any,
    confidence: Any,
    flow: Any,
    validity: Any,
    matte: Any,
    settings: OutlierSettings | None = None,
) -> tuple[Single, OutlierReport]:
    """Lowers the confidence of inconsistent frames and regions.

    Args:
        observed: [T, H, W] or [C, T, H, W].
        confidence: like observed, or [T, H, W].
        flow: [T-1, H, W, 2].
        validity: [T-1, H, W].
        matte: [T, H, W] or None.
        settings: None for the defaults.

    Returns:
        Confidence, float32, of the shape of `observed`; and the report. With `OUTLIER_HALO` frames around a block the
        block's frames get the same values as in the whole sequence.

    Raises:
        JobError: as `solve`.
    """
    settings = settings or OutlierSettings()
    inputs = check_inputs(observed, confidence, flow, validity, matte)
    vectors, valid = np.asarray(flow, np.float32), np.asarray(validity, np.float32)
    last = len(inputs.matte) - 1

    def read(t: int) -> ObservedFrame:
        link = (vectors[t], valid[t]) if t < last else (None, None)
        return ObservedFrame(inputs.observed[:, t], inputs.matte[t], *link)

    found = list(frame_consistency(read, last + 1, settings))
    ratio = tuple(one.ratio for one in found)
    frames = tuple(t for t, r in enumerate(ratio) if r > settings.limit)
    result = inputs.confidence * np.stack([one.weight for one in found], axis=1)
    return result.reshape(np.shape(observed)), OutlierReport(ratio, tuple(t.downweighted for t in found), frames)


def frame_consistency(
    read: Callable[[int], ObservedFrame], length: int, settings: OutlierSettings | None = None
) -> Iterator[FrameConsistency]:
    """Yields the consistency of each of `length` frames in order; memory does not depend on the length.

    Args:
        read: returns the frame at a position; called once per frame, in order.
        length: number of frames.
        settings: None for the defaults.
    """
    settings = settings or OutlierSettings()
    tracks = Tracks(read, length)
    residuals: dict[int, Single] = {}
    levels: dict[int, NDArray[np.float64]] = {}
    for t in range(length + WINDOW):
        if t < length:
            residuals[t] = tracks.residual(t)
            levels[t] = _levels(residuals[t])
        done = t - WINDOW
        if done >= 0:
            window = [levels[k] for k in range(max(0, done - WINDOW), min(length, done + WINDOW + 1))]
            usual = np.maximum(np.median(window, axis=0), settings.usual_floor)
            yield _consistency(residuals.pop(done), tracks.mattes.pop(done), usual, levels[done][0], settings)


def _levels(residual: Single) -> NDArray[np.float64]:
    """Median and scaled mean over the pixels of a frame's residuals [C, n]: [2, C].

    The mean is scaled so that both agree for normally distributed values.
    """
    if residual.size == 0:
        return np.zeros((2, len(residual)))
    return np.stack([np.median(residual, axis=1), MEDIAN_OF_MEAN * np.mean(residual, axis=1, dtype=np.float64)])


def _consistency(
    residual: Single, matte: Mask, usual: NDArray[np.float64], median: NDArray[np.float64], settings: OutlierSettings
) -> FrameConsistency:
    """Consistency of a frame from its residuals [C, n]; `usual` is [2, C] as in `_levels`, `median` [C].

    A region is compared with the larger of the usual median and mean. Where the predicted class of a few pixels changes
    from frame to frame (metallic), the median is 0, and every such pixel would count as an outlier.
    """
    weight = np.ones((len(residual), *matte.shape), np.float32)
    for channel, part in enumerate(residual):
        dense = np.zeros(matte.shape, np.float32)
        dense[matte] = part
        ratio = median[channel] / usual[0, channel]
        local = np.maximum(box_mean(dense, matte, settings.region) / usual[:, channel].max(), ratio)
        weight[channel] = np.minimum(1.0, (settings.limit / np.maximum(local, settings.limit)) ** 4)
    low = weight[:, matte] < 0.5
    downweighted = float(low.mean(axis=1).max()) if low.size else 0.0
    return FrameConsistency(weight, float(np.max(median / usual[0])), downweighted)


def consistent_members(
    members: NDArray[np.floating], matte: Mask, limit: float = 4.0
) -> tuple[Mask, NDArray[np.float64]]:
    """Finds the members of one frame's ensemble that agree with the others.

    Args:
        members: [K, H, W] predictions of one frame.
        matte: [H, W].
        limit: a member is rejected if its distance exceeds this times the median distance.

    Returns:
        [K] bool, True for members that agree (all for K < 3, where there is no majority); and [K] distances: the median
        over the matte of |member - median of members|.
    """
    inside = np.asarray(members)[:, matte]
    if inside.shape[1] == 0:
        return np.ones(len(inside), bool), np.zeros(len(inside))
    distance = np.median(np.abs(inside - np.median(inside, axis=0)), axis=1).astype(np.float64)
    if len(inside) < 3:
        return np.ones(len(inside), bool), distance
    return distance <= limit * max(float(np.median(distance)), 0.0025), distance
