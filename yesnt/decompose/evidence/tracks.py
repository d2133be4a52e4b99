"""Tracks: where a frame's pixels are in other frames of the same camera, along the optical flow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.reuse import Link, chained

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

LEAST_VALIDITY = 0.5
"""Product of the validities along a track below which it is lost."""


def later_places(links: Sequence[Link], mattes: Sequence[Mask]) -> F32:
    """Place [H, W, 2] (column, row) of a frame's pixels in a later one; NaN where a track is lost.

    Args:
        links: flow from the frame to the later one, in order of time; at least one.
        mattes: [H, W] of every frame from the one to the other: one more than links.
    """
    flow, validity = chained(links, mattes)
    height, width = validity.shape
    place = flow + np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    lost = (validity < LEAST_VALIDITY) | ~mattes[0]
    return np.where(lost[..., None], np.nan, place).astype(np.float32)


def earlier_places(links: Sequence[Link], mattes: Sequence[Mask]) -> F32:
    """Place [H, W, 2] of the last frame's pixels in the first one: the inverse of `later_places`.

    Every pixel of the first frame is taken where its track leads. Of several that reach one pixel the nearest counts,
    and of those the first in order of rows.

    Args:
        links: flow from the earlier frame to the frame, in order of time; at least one.
        mattes: of every frame from the one to the other.
    """
    there = later_places(links, mattes)
    height, width = mattes[-1].shape
    inverse = np.full((height * width, 2), np.nan, np.float32)
    from_row, from_column = np.nonzero(np.isfinite(there[..., 0]))
    reached = there[from_row, from_column]
    pixel = np.rint(reached).astype(np.int64)
    inside = ((pixel >= 0) & (pixel < (width, height))).all(axis=1)
    beside, pixel = (pixel - reached)[inside], pixel[inside]
    origin = np.stack([from_column, from_row], axis=1)[inside]
    target = pixel[:, 1] * width + pixel[:, 0]
    order = np.lexsort((np.square(beside).sum(axis=1), target))
    _, first = np.unique(target[order], return_index=True)
    chosen = order[first]
    inverse[target[chosen]] = origin[chosen] + beside[chosen]
    inverse[~mattes[-1].reshape(-1)] = np.nan
    return inverse.reshape(height, width, 2)
