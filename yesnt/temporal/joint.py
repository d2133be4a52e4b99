"""Pixels that are solved together over the whole sequence: those that an exchange between blocks still moved.

Blocks that only exchange borders agree fast where data holds a pixel: each exchange takes rho^(2 halo + 2) of what is
left. Where data does not (a confidence near 0, or metal against gloss in Huber's tail, whose pull has no stiffness) a
patch moves as one through all blocks, and news of it travels one block a sweep. Such pixels are few. So between two
exchanges they are set free in all frames at once, with all others fixed: one more step of Schwarz's method, whose
subdomain is not a box but the loose pixels themselves. It lowers F, whatever was chosen to be loose.

They are widened by `MARGIN` pixels, to the whole frame where most of it moved: pixels that happened to stay where they
were would pin the patch around them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Single = NDArray[np.float32]

MARGIN = 2
"""Pixels around one that moved which are set free with it."""

MOST = 0.5
"""Share of a frame's matte that moved, from which all of it is set free."""

STEPS_PER_OCTAVE, OCTAVES, LARGEST = 16, 40, 8.0
"""Bins in which changes are counted: from LARGEST down, in steps of 2^(1/16)."""


@dataclass(frozen=True)
class FrameLinks:
    """One frame as the rim needs it: [H, W] matte; flow [H, W, 2] to the next and its validity, None at the end."""

    matte: Mask
    flow: Single | None
    validity: Single | None


class ChangeCounter:
    """Counts pixels by how far they moved, so that a threshold can be chosen without keeping the changes."""

    def __init__(self) -> None:
        self._counts = np.zeros(STEPS_PER_OCTAVE * OCTAVES + 1, np.int64)

    def add(self, change: Single) -> None:
        """Counts one frame's changes [n], >= 0."""
        with np.errstate(divide="ignore"):
            octave = np.log2(LARGEST / change)
        index = np.clip(np.ceil(STEPS_PER_OCTAVE * octave), 0, len(self._counts) - 1).astype(np.int64)
        self._counts += np.bincount(index, minlength=len(self._counts))

    def threshold(self, smallest: float, most: int) -> float:
        """The change from which a pixel is loose: `smallest`, or more if more than `most` pixels moved by that."""
        within = np.flatnonzero(np.cumsum(self._counts) <= most)
        if len(within) == 0:
            return float("inf")
        return max(smallest, LARGEST * 2.0 ** (-float(within[-1]) / STEPS_PER_OCTAVE))


def loose_pixels(moved: Mask, matte: Mask) -> Mask:
    """The pixels [H, W] that are set free where some have moved: these and the matte pixels around them."""
    count = np.count_nonzero(moved)
    if count == 0 or count > MOST * np.count_nonzero(matte):
        return matte & (count > 0)
    for _ in range(MARGIN):
        moved = _dilate(moved)
    return moved & matte


def listed_frames(read: Callable[[int], FrameLinks], free: Callable[[int], Mask], length: int) -> Iterator[Mask]:
    """The pixels that a joint solve lists, frame by frame: the free ones and the rim that their terms of F reach.

    Args:
        read: gives a frame of the sequence by position; asked in order.
        free: gives the free pixels [H, W] of a frame; subset of its matte.
        length: of the sequence.

    Yields:
        [H, W] bool per frame. The rim holds the eight neighbours of a free pixel, whatever its flow samples, whatever
        samples it, and the other samples of those: bilinear weights are renormalised over listed pixels (geometry.py),
        so every link that touches a free pixel must find all of its samples.
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
    """Pixels of this frame whose link touches a free pixel, and all pixels of the next that these sample."""
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
