"""The whole subject in small: whether a red patch is a shirt or a face is plain only from where on a person it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

CONTEXT_SIDE = 96
"""Side of the small picture in pixels."""

_STRAY = 0.002
"""Share of the matte that may lie outside the square on each side: specks of a bad key do not shrink the subject."""

_MARGIN = 1.08
"""Side of the square over the longer side of the subject."""


class ContextBatch(NamedTuple):
    """What a batch of patches is told of its surroundings.

    Attributes:
        image: [B, 4, CONTEXT_SIDE, CONTEXT_SIDE] straight linear rgb and matte of the whole subject.
        location: [B, 3] top, left and side of the patch, in sides of that picture.
        auxiliary: [B, C, s, s] what the backend said of the whole subject when it was shown it; None: it was not.
    """

    image: torch.Tensor
    location: torch.Tensor
    auxiliary: torch.Tensor | None = None


@dataclass(frozen=True)
class Square:
    """A square of a frame in pixels; it may reach out of the frame."""

    top: int
    left: int
    side: int

    @classmethod
    def around(cls, matte: Float32) -> Square:
        """The square in whose middle the subject lies; the frame's middle where the matte [H, W] is empty."""
        if not matte.any():
            return cls(0, 0, max(matte.shape))
        (top, bottom), (left, right) = (_bounds(matte.sum(axis)) for axis in (1, 0))
        side = int(np.ceil(_MARGIN * max(bottom - top, right - left)))
        return cls((top + bottom - side) // 2, (left + right - side) // 2, side)

    def shrink(self, planes: Float32, side: int = CONTEXT_SIDE) -> Float32:
        """Planes [C, H, W] of the frame to [C, side, side] of this square, averaged; 0 outside the frame."""
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
        """Top, left and side of a patch in sides of this square."""
        return (top - self.top) / self.side, (left - self.left) / self.side, size / self.side


def context_image(rgb: Float32, matte: Float32, square: Square, side: int = CONTEXT_SIDE) -> Float32:
    """[4, side, side] straight rgb and matte.

    Args:
        rgb: [3, H, W] straight linear Rec.709.
        matte: [H, W] coverage.
        square: what to show.
        side: in pixels.
    """
    small = square.shrink(np.concatenate([rgb * matte, matte[None]]), side)
    colour = small[:3] / np.maximum(small[3:], 1 / 64)
    return np.concatenate([np.where(small[3:] > 1 / 64, colour, 0), small[3:]]).astype(np.float32)


def _bounds(profile: NDArray[np.floating]) -> tuple[int, int]:
    """First and past-the-last position of a profile without its stray ends."""
    share = np.cumsum(profile, dtype=np.float64) / profile.sum(dtype=np.float64)
    low, high = np.searchsorted(share, [_STRAY, 1 - _STRAY])
    return int(low), int(high) + 1
