"""Joint solve of the unconverged pixels over the whole sequence, between exchanges of block borders.

The exchange converges fast where the data weight is large: each sweep multiplies the error by rho^(2 halo + 2). It is
slow where the data term has little stiffness: at confidence near 0, and in the linear part of the Huber function. There
a connected patch moves as one through all blocks, and a change travels one block per sweep. Such pixels are few.
Between two exchanges they are therefore solved in all frames at once, with all other pixels fixed. This is a step of
Schwarz's alternating method whose subdomain is the set of unconverged pixels; it lowers F for any choice of that set.

The set is widened by `MARGIN` pixels, or to the whole frame where most of the frame moved, because pixels that did not
move by chance would otherwise hold the patch around them in place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Single = NDArray[np.float32]

MARGIN = 2
"""Pixels by which the set of moved pixels is widened on every side."""

MOST = 0.5
"""Share of moved matte pixels above which the whole frame is solved."""

STEPS_PER_OCTAVE, OCTAVES, LARGEST = 16, 40, 8.0
"""Logarithmic bins of the change histogram: from LARGEST down, in steps of 2^(1/16)."""


@dataclass(frozen=True)
class FrameLinks:
    """Matte [H, W], flow [H, W, 2] to the next frame and its validity [H, W]; None at the last frame."""

    matte: Mask
    flow: Single | None
    validity: Single | None


class ChangeCounter:
    """Histogram of the pixels' changes, from which a threshold is chosen without storing the changes."""

    def __init__(self) -> None:
        self._counts = np.zeros(STEPS_PER_OCTAVE * OCTAVES + 1, np.int64)

    def add(self, change: Single) -> None:
        """Adds one frame's changes [n], >= 0."""
        with np.errstate(divide="ignore"):
            octave = np.log2(LARGEST / change)
        index = np.clip(np.ceil(STEPS_PER_OCTAVE * octave), 0, len(self._counts) - 1).astype(np.int64)
        self._counts += np.bincount(index, minlength=len(self._counts))

    def threshold(self, smallest: float, most: int) -> float:
        """Change above which a pixel is unconverged: `smallest`, or more so that at most `most` pixels are."""
        within = np.flatnonzero(np.cumsum(self._counts) <= most)
        if len(within) == 0:
            return float("inf")
        return max(smallest, LARGEST * 2.0 ** (-float(within[-1]) / STEPS_PER_OCTAVE))


def unconverged_pixels(moved: Mask, matte: Mask) -> Mask:
    """Free pixels [H, W] of a frame: the moved ones and the matte pixels within `MARGIN` of them."""
    count = np.count_nonzero(moved)
    if count == 0 or count > MOST * np.count_nonzero(matte):
        return matte & (count > 0)
    for _ in range(MARGIN):
        moved = _dilate(moved)
    return moved & matte


def listed_frames(read: Callable[[int], FrameLinks], free: Callable[[int], Mask], length: int) -> Iterator[Mask]:
    """Yields the pixels of a joint solve, frame by frame: the free ones and all others that their terms of F contain.

    Args:
        read: returns the frame at a position; called in order.
        free: returns the free pixels [H, W] at a position; a subset of the matte.
        length: number of frames.

    Yields:
        [H, W] bool per frame. The other pixels are the eight neighbours of a free pixel, the samples of its link, the
        pixels whose links sample it, and the other samples of those links: bilinear weights are renormalised over
        listed pixels (geometry.py), so every link that touches a free pixel needs all of its samples.
    """
    arriving: Mask | None = None
    here = free(0)
    for t in range(length):
        frame = read(t)
        following = free(t + 1) if t + 1 < length else None
        listed = _dilate(here)
        if arriving is not None:
            listed |= arriving
        if following is not None and frame.flow is not None and frame.validity is not None:
            touching, arriving = _touching(frame.flow, frame.matte & (frame.validity > 0), here, following)
            listed |= touching
        else:
            arriving = None
        yield listed & frame.matte
        if following is not None:
            here = following


def _dilate(mask: Mask) -> Mask:
    """The mask and its eight neighbours."""
    padded = np.pad(mask, 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def _touching(flow: Single, linked: Mask, here: Mask, following: Mask) -> tuple[Mask, Mask]:
    """Pixels of this frame whose link touches a free pixel, and the pixels of the next frame that they sample."""
    height, width = here.shape
    row, column = np.nonzero(linked)
    x, y = column + flow[row, column, 0].astype(np.float64), row + flow[row, column, 1].astype(np.float64)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    row, column, x0, y0 = row[inside], column[inside], x[inside].astype(np.int64), y[inside].astype(np.int64)
    around = np.pad(following, ((0, 1), (0, 1)))
    sampled = around[y0, x0] | around[y0, x0 + 1] | around[y0 + 1, x0] | around[y0 + 1, x0 + 1]
    used = here[row, column] | sampled
    touching, arriving = np.zeros_like(here), np.zeros((height + 1, width + 1), bool)
    touching[row[used], column[used]] = True
    for down in (0, 1):
        for right in (0, 1):
            arriving[y0[used] + down, x0[used] + right] = True
    return touching, arriving[:height, :width]
