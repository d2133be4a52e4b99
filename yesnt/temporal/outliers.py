"""Frames and members whose prediction is strongly inconsistent: found by robust statistics, trusted less, reported.

Such predictions are the paper's own limitation: a least-squares coupling in time would smear them over their
neighbours. A frame is compared with what its neighbours predict for it along the flow: the residual from the median of
up to five values (the frame itself and two frames to each side) is large where the frame is alone with its opinion, and
stays small in the clean frames next to it.
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
"""Frames on each side whose residuals tell what is usual."""

MEDIAN_OF_MEAN = 0.845
"""Median over mean of the absolute value of a normal variable."""

BRIDGE = 2.0
"""Weight of sure links into and out of an inconsistent frame: it has no say of its own, and two links in series that
are twice as stiff couple the frames beside it as closely as neighbours are coupled."""

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


@dataclass(frozen=True)
class FrameTrust:
    """What one frame is worth.

    Attributes:
        weight: [C, H, W] in [0, 1], to be multiplied on the confidence.
        ratio: its median residual over the usual one, worst channel.
        distrusted: share of its matte pixels whose weight is below one half, worst channel.
    """

    weight: Single
    ratio: float
    distrusted: float


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
    vectors, valid = np.asarray(flow, np.float32), np.asarray(validity, np.float32)
    last = len(inputs.matte) - 1

    def read(t: int) -> ObservedFrame:
        link = (vectors[t], valid[t]) if t < last else (None, None)
        return ObservedFrame(inputs.observed[:, t], inputs.matte[t], *link)

    found = list(frame_trust(read, last + 1, settings))
    ratio = tuple(trust.ratio for trust in found)
    frames = tuple(t for t, r in enumerate(ratio) if r > settings.limit)
    result = inputs.confidence * np.stack([trust.weight for trust in found], axis=1)
    return result.reshape(np.shape(observed)), OutlierReport(ratio, tuple(t.distrusted for t in found), frames)


def bridged_links(validity: Any, frames: tuple[int, ...]) -> Single:
    """Validity [T-1, H, W] with `bridge` around inconsistent frames (`OutlierReport.frames`)."""
    links = np.array(validity, np.float32)
    around = sorted({t for frame in frames for t in (frame - 1, frame) if 0 <= t < len(links)})
    links[around] = bridge(links[around])
    return links


def bridge(validity: Single) -> Single:
    """Weight of links beside an inconsistent frame: `BRIDGE` times validity squared.

    Where no data holds against it a doubtful link is followed in full, however small its weight; and both of two links
    in series have to be right: so what is doubtful counts twice as doubtful.
    """
    return (BRIDGE * validity * validity).astype(np.float32)


def frame_trust(
    read: Callable[[int], ObservedFrame], length: int, settings: OutlierSettings | None = None
) -> Iterator[FrameTrust]:
    """Trust of each of `length` frames in order; holds the pixel lists of few frames at a time, whatever the length.

    Args:
        read: gives a frame by position; asked once for each, in order.
        length: how many frames there are.
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
            yield _trust(residuals.pop(done), tracks.mattes.pop(done), usual, levels[done][0], settings)


def _levels(residual: Single) -> NDArray[np.float64]:
    """Median and mean over the pixels of a frame's residuals [C, n], the mean as the median of normal ones: [2, C]."""
    if residual.size == 0:
        return np.zeros((2, len(residual)))
    return np.stack([np.median(residual, axis=1), MEDIAN_OF_MEAN * np.mean(residual, axis=1, dtype=np.float64)])


def _trust(
    residual: Single, matte: Mask, usual: NDArray[np.float64], median: NDArray[np.float64], settings: OutlierSettings
) -> FrameTrust:
    """Trust of a frame from its residuals [C, n]; `usual` is [2, C] as in `_levels`, `median` [C].

    A region is measured against the usual mean: where a class flips here and there from frame to frame (metal), the
    median is 0 and every flip would count as an outlier, so that the minority, right or wrong, would lose its vote.
    """
    weight = np.ones((len(residual), *matte.shape), np.float32)
    for channel, part in enumerate(residual):
        dense = np.zeros(matte.shape, np.float32)
        dense[matte] = part
        ratio = median[channel] / usual[0, channel]
        local = np.maximum(box_mean(dense, matte, settings.region) / usual[:, channel].max(), ratio)
        weight[channel] = np.minimum(1.0, (settings.limit / np.maximum(local, settings.limit)) ** 4)
    low = weight[:, matte] < 0.5
    return FrameTrust(weight, float(np.max(median / usual[0])), float(low.mean(axis=1).max()) if low.size else 0.0)


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
