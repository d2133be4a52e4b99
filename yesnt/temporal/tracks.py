"""Predictions of a frame's values by its neighbours along the flow; keeps few frames in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.geometry import build_geometry

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]

REACH = 2
"""Frames on each side that predict a frame."""


@dataclass(frozen=True)
class ObservedFrame:
    """One frame as the caller reads it.

    Attributes:
        observed: [C, H, W].
        matte: [H, W] bool.
        flow: [H, W, 2] to the next frame; None at the last.
        validity: [H, W] of it.
    """

    observed: Single
    matte: Mask
    flow: Single | None
    validity: Single | None


@dataclass(frozen=True)
class Pair:
    """Links of one frame's n pixels to the next frame's m pixels.

    Attributes:
        corners: [4, n] indices of the bilinear samples in the next frame.
        weights: [4, n] their weights, 0 for absent samples.
        link: [n] validity.
        following: m.
    """

    corners: NDArray[np.uint32]
    weights: Single
    link: Single
    following: int

    @classmethod
    def between(cls, here: ObservedFrame, matte: Mask) -> Pair:
        """Builds the links of a frame to the next one, whose matte [H, W] is given."""
        assert here.flow is not None
        assert here.validity is not None
        geometry = build_geometry(np.stack([here.matte, matte]), here.flow[None], here.validity[None])
        count = int(geometry.frames[1])
        first = np.stack([geometry.top, geometry.top + 1, geometry.bottom, geometry.bottom + 1])[:, :count]
        # Absent corners have weight 0: any index inside the frame will do.
        following = geometry.pixels - count
        corners = np.clip(first.astype(np.int64) - count, 0, max(following - 1, 0)).astype(np.uint32)
        return cls(corners, geometry.weights[:count].T.copy(), geometry.link[:count].copy(), following)

    def from_next(self, values: Single) -> Single:
        """Warps the next frame's values [m] to this frame (W): [n], NaN without a valid link."""
        total = np.zeros(len(self.link), np.float32)
        if self.following:
            for index, weight in zip(self.corners, self.weights, strict=True):
                total += np.where(weight > 0, weight * values[index], 0.0)
        return np.where(self.link > 0.5, total, np.nan).astype(np.float32)

    def from_previous(self, values: Single) -> Single:
        """Splats this frame's values [n] into the next (W^T values / W^T 1): [m], NaN below half the weight."""
        total, count = np.zeros(self.following), np.zeros(self.following)
        known = (self.link > 0.5) & ~np.isnan(values)
        for index, weight in zip(self.corners, self.weights, strict=True):
            used = known & (weight > 0)
            total += np.bincount(index[used], weight[used] * values[used].astype(np.float64), self.following)
            count += np.bincount(index[used], weight[used].astype(np.float64), self.following)
        return np.where(count > 0.5, total / np.maximum(count, 0.5), np.nan).astype(np.float32)


class Tracks:
    """Computes the residuals of a sequence; holds the frames within `REACH` of the current one.

    Args:
        read: returns the frame at a position; called once per frame, in order.
        length: number of frames.
    """

    def __init__(self, read: Callable[[int], ObservedFrame], length: int) -> None:
        self._read, self._length, self._next = read, length, 0
        self._values: dict[int, Single] = {}
        self._pairs: dict[int, Pair] = {}
        self._last: ObservedFrame | None = None
        self.mattes: dict[int, Mask] = {}

    def residual(self, t: int) -> Single:
        """Distance of each pixel of frame t from the median of its value and its predictions: [C, n].

        0 where fewer than two predictions reach the pixel, because then there is no majority.
        """
        while self._next <= min(t + REACH, self._length - 1):
            self._load(self._next)
            self._next += 1
        for old in [k for k in self._values if k < t - REACH]:
            del self._values[old]
            del self._pairs[old]
        channels = range(len(self._values[t]))
        return np.stack([self._channel_residual(t, c) for c in channels])

    def _load(self, t: int) -> None:
        frame = self._read(t)
        if self._last is not None:
            self._pairs[t - 1] = Pair.between(self._last, frame.matte)
        self._values[t], self.mattes[t] = frame.observed[:, frame.matte], frame.matte
        self._last = frame

    def _channel_residual(self, t: int, channel: int) -> Single:
        here = self._values[t][channel]
        rows = [here]
        for k in range(1, REACH + 1):
            if t + k < self._length:
                rows.append(self._carried_back(t, k, channel))
            if t - k >= 0:
                rows.append(self._carried_on(t, k, channel))
        stack = np.sort(np.stack(rows), axis=0)  # NaN, for "no prediction", sorts to the end
        count = np.sum(~np.isnan(stack), axis=0)
        lower = np.take_along_axis(stack, (count - 1)[None] // 2, axis=0)[0]
        upper = np.take_along_axis(stack, count[None] // 2, axis=0)[0]
        return np.where(count >= 3, np.abs(here - 0.5 * (lower + upper)), 0.0).astype(np.float32)

    def _carried_back(self, t: int, k: int, channel: int) -> Single:
        """Values of frame t + k, warped back to frame t."""
        values = self._values[t + k][channel]
        for step in reversed(range(t, t + k)):
            values = self._pairs[step].from_next(values)
        return values

    def _carried_on(self, t: int, k: int, channel: int) -> Single:
        """Values of frame t - k, splatted forward to frame t."""
        values = self._values[t - k][channel]
        for step in range(t - k, t):
            values = self._pairs[step].from_previous(values)
        return values
