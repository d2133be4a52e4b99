"""Overlapping patches and the windows that blend them (method.md section 3). NumPy only, no network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from yesnt.core.blocks import patch_origins

Float32 = NDArray[np.float32]
Number = TypeVar("Number", bound=np.generic)

_FIXED_POINT = 1 << 28
"""Steps per unit of the accumulator: integer sums do not depend on the order of the patches, float sums do."""


def raised_cosine(size: int) -> NDArray[np.float64]:
    """Hann window of `size` samples at half-sample offsets, so that no weight is 0 and borders can be normalised."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(size) + 0.5) / size)


def unit_windows(origins: tuple[int, ...], size: int, length: int) -> NDArray[np.float64]:
    """Raised-cosine windows at `origins`, normalised so that they sum to 1 at every position of [0, length).

    Returns:
        [len(origins), size].
    """
    window = raised_cosine(size)
    total = np.zeros(length)
    for origin in origins:
        total[origin : origin + size] += window
    return np.stack([window / total[origin : origin + size] for origin in origins])


@dataclass(frozen=True)
class Patch:
    """Where a patch lies: first row and column, and its numbers in the grid."""

    top: int
    left: int
    row: int
    column: int


@dataclass(frozen=True)
class PatchGrid:
    """Patches that cover a frame and their separable windows.

    Attributes:
        height: rows of the frame, at least one patch (callers pad smaller frames).
        width: columns, likewise.
        size: side of a patch.
        patches: every patch, row by row.
        row_windows: [rows of patches, size].
        column_windows: [columns of patches, size].
    """

    height: int
    width: int
    size: int
    patches: tuple[Patch, ...]
    row_windows: NDArray[np.float64]
    column_windows: NDArray[np.float64]

    @classmethod
    def cover(cls, height: int, width: int, size: int, overlap: float, align: int = 1) -> PatchGrid:
        """Covers a frame with patches that overlap by at least the fraction `overlap` of their side.

        Args:
            height: rows; the grid's own may be larger, up to a multiple of `align` and at least one patch.
            width: columns, likewise.
            size: side of a patch, a multiple of `align`.
            overlap: in [0, 1).
            align: origins are multiples of it.

        Raises:
            ValueError: overlap is out of range or the size is not aligned.
        """
        if not 0 <= overlap < 1 or size % align:
            raise ValueError(f"overlap {overlap} must be in [0, 1) and the patch {size} a multiple of {align}")
        height, width = (max(-(-length // align) * align, size) for length in (height, width))
        # Counted in units of `align`, so that every origin is aligned and the overlap still holds.
        units = min(math.ceil(overlap * size / align), size // align - 1)
        tops, lefts = (
            tuple(align * origin for origin in patch_origins(length // align, size // align, units))
            for length in (height, width)
        )
        patches = tuple(Patch(top, left, i, j) for i, top in enumerate(tops) for j, left in enumerate(lefts))
        return cls(height, width, size, patches, unit_windows(tops, size, height), unit_windows(lefts, size, width))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the padded frame."""
        return self.height, self.width

    def window(self, patch: Patch) -> Float32:
        """Weights [size, size] of a patch; over all patches they sum to 1 at every pixel (to 1e-6)."""
        return np.outer(self.row_windows[patch.row], self.column_windows[patch.column]).astype(np.float32)

    def crop(self, image: NDArray[Number], patch: Patch) -> NDArray[Number]:
        """The patch's part of `[..., height, width]`."""
        return image[..., patch.top : patch.top + self.size, patch.left : patch.left + self.size]

    def covering(self, matte: Float32) -> tuple[Patch, ...]:
        """The patches that see any matte; together they cover every matte pixel with a full sum of windows."""
        return tuple(patch for patch in self.patches if self.crop(matte, patch).any())


class PatchSum:
    """Windowed sum of patches over a frame: the same bits in any order of `add`.

    Values must lie in [-1, 1]; sums are kept as 32-bit integers in steps of 2^-28 (4e-9).
    """

    def __init__(self, grid: PatchGrid, planes: int) -> None:
        self._grid = grid
        self._sum = np.zeros((planes, grid.height, grid.width), dtype=np.int32)

    def add(self, patch: Patch, values: Float32) -> None:
        """Adds `values` [planes, size, size] times the patch's window."""
        weighted = values.astype(np.float64) * self._grid.window(patch)
        self._grid.crop(self._sum, patch)[...] += np.rint(weighted * _FIXED_POINT).astype(np.int32)

    def value(self) -> Float32:
        """The sum [planes, height, width]."""
        value = self._sum.astype(np.float32)
        value *= np.float32(1.0 / _FIXED_POINT)  # a power of two: nothing is rounded twice
        return value
