"""True visibility of a frame's points in the next frame, from true flow and true planar depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

DEPTH_STEP = 0.03
"""Largest relative change of z from one frame to the next at which a pixel still shows the same point."""


def visible_in_next(
    flow: NDArray[np.floating], z: NDArray[np.floating], next_z: NDArray[np.floating], matte: Mask, next_matte: Mask
) -> Mask:
    """Where a point of this frame is visible in the next one, [H, W].

    A point is visible if p + flow lies in the frame and one of the four pixels around it belongs to the next matte and
    has the same z to `DEPTH_STEP`. Anything nearer occludes it.

    Args:
        flow: [H, W, 2] true flow in pixels.
        z: [H, W] planar depth of this frame, metres.
        next_z: [H, W] of the next frame.
        matte: [H, W] of this frame.
        next_matte: [H, W] of the next frame.
    """
    height, width = z.shape
    x, y = np.arange(width) + flow[..., 0], np.arange(height)[:, None] + flow[..., 1]
    within = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    column = np.clip(np.floor(x), 0, width - 2).astype(int)
    row = np.clip(np.floor(y), 0, height - 2).astype(int)
    seen = np.zeros((height, width), bool)
    for down in (0, 1):
        for right in (0, 1):
            there = row + down, column + right
            seen |= next_matte[there] & (np.abs(next_z[there] - z) <= DEPTH_STEP * z)
    return matte & within & seen
