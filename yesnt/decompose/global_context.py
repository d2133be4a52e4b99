"""Global context of a patch: a small image of the whole subject and the patch's location on it.

A patch alone is ambiguous: a red patch may show a shirt or a face. Its location on the subject resolves that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

CONTEXT_SIDE = 96
"""Side of the context image in pixels."""

_OUTLIER_FRACTION = 0.002
"""Fraction of the matte that may lie outside the square on each side, so that specks of the key do not enlarge it."""

_MARGIN = 1.08
"""Side of the square over the longer side of the subject."""


class ContextBatch(NamedTuple):
    """Global context of a batch of patches.

    Attributes:
        image: [B, 4, CONTEXT_SIDE, CONTEXT_SIDE] straight linear rgb and matte of the whole subject.
        location: [B, 3] top, left and side of the patch in units of the side of the image's square.
        auxiliary: [B, C, s, s] what the backend's `predict_auxiliary` returned for the subject; None: not available.
    """

    image: torch.Tensor
    location: torch.Tensor
    auxiliary: torch.Tensor | None = None


@dataclass(frozen=True)
class Square:
    """Square region of a frame in pixels; it may extend beyond the frame.

    Attributes:
        top: first row.
        left: first column.
        side: rows and columns.
    """

    top: int
    left: int
    side: int

    @classmethod
    def around(cls, matte: Float32) -> Square:
        """Returns the square centred on the subject of a matte [H, W], or one over the frame if the matte is empty."""
        if not matte.any():
            return cls(0, 0, max(matte.shape))
        (top, bottom), (left, right) = (_bounds(matte.sum(axis)) for axis in (1, 0))
        side = int(np.ceil(_MARGIN * max(bottom - top, right - left)))
        return cls((top + bottom - side) // 2, (left + right - side) // 2, side)

    def resample(self, planes: Float32, side: int = CONTEXT_SIDE) -> Float32:
        """Resamples planes [C, H, W] of a frame to [C, side, side] over this square; 0 outside the frame.

        Minification averages areas, magnification is bilinear.
        """
        height, width = planes.shape[1:]
        square = np.zeros((self.side, self.side, len(planes)), np.float32)
        rows = slice(max(self.top, 0), min(self.top + self.side, height))
        columns = slice(max(self.left, 0), min(self.left + self.side, width))
        inside = np.s_[
            rows.start - self.top : rows.stop - self.top, columns.start - self.left : columns.stop - self.left
        ]
        square[inside] = planes[:, rows, columns].transpose(1, 2, 0)
        small = cv2.resize(square, (side, side), interpolation=cv2.INTER_AREA if side < self.side else cv2.INTER_LINEAR)
        return np.ascontiguousarray(small.reshape(side, side, -1).transpose(2, 0, 1))

    def locate(self, top: int, left: int, size: int) -> tuple[float, float, float]:
        """Returns top, left and side of a patch at (top, left) of `size` pixels, in units of this square's side."""
        return (top - self.top) / self.side, (left - self.left) / self.side, size / self.side


def context_image(rgb: Float32, matte: Float32, square: Square, side: int = CONTEXT_SIDE) -> Float32:
    """Renders the subject at a small size.

    Args:
        rgb: [3, H, W] straight linear Rec.709.
        matte: [H, W] coverage in [0, 1].
        square: region to show.
        side: side of the result in pixels.

    Returns:
        [4, side, side] straight rgb and matte; rgb is 0 where the coverage is at most 1/64.
    """
    small = square.resample(np.concatenate([rgb * matte, matte[None]]), side)
    colour = small[:3] / np.maximum(small[3:], 1 / 64)
    return np.concatenate([np.where(small[3:] > 1 / 64, colour, 0), small[3:]]).astype(np.float32)


def _bounds(profile: NDArray[np.floating]) -> tuple[int, int]:
    """First position, and one past the last, of a profile without `_OUTLIER_FRACTION` of its sum at either end."""
    cumulative = np.cumsum(profile, dtype=np.float64) / profile.sum(dtype=np.float64)
    low, high = np.searchsorted(cumulative, [_OUTLIER_FRACTION, 1 - _OUTLIER_FRACTION])
    return int(low), int(high) + 1
