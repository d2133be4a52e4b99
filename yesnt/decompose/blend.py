"""Overlapping patches and the windows that blend them (docs/method.md section 3). NumPy only."""

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
"""Steps per unit of the accumulator. Integer sums do not depend on the order of the patches; float sums do."""


def raised_cosine(size: int) -> NDArray[np.float64]:
    """Returns a Hann window of `size` samples at half-sample offsets: no weight is 0, so borders can be normalised."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(size) + 0.5) / size)


def unit_windows(origins: tuple[int, ...], size: int, length: int) -> NDArray[np.float64]:
    """Returns raised-cosine windows at `origins` that sum to 1 at every position of [0, length).

    Args:
        origins: first position of each window; together the windows cover [0, length).
        size: samples of a window.
        length: samples to cover.

    Returns:
        [len(origins), size] float64.
    """
    window = raised_cosine(size)
    total = np.zeros(length)
    for origin in origins:
        total[origin : origin + size] += window
    return np.stack([window / total[origin : origin + size] for origin in origins])


@dataclass(frozen=True)
class Patch:
    """Position of a patch.

    Attributes:
        top: first row in pixels.
        left: first column in pixels.
        row: row number in the grid of patches.
        column: column number in the grid of patches.
    """

    top: int
    left: int
    row: int
    column: int


@dataclass(frozen=True)
class PatchGrid:
    """Patches that cover a frame, and their separable windows.

    Attributes:
        height: rows of the padded frame, at least `size`.
        width: columns of the padded frame, at least `size`.
        size: side of a patch in pixels.
        patches: all patches, row by row.
        row_windows: [rows of patches, size] vertical weights.
        column_windows: [columns of patches, size] horizontal weights.
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
            height: rows of the frame; the grid pads them to a multiple of `align` and to at least one patch.
            width: columns of the frame, padded likewise.
            size: side of a patch in pixels, a multiple of `align`.
            overlap: fraction in [0, 1).
            align: patch origins are multiples of this many pixels.

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
        """Returns the weights [size, size] of a patch; over all patches they sum to 1 at every pixel (to 1e-6)."""
        return np.outer(self.row_windows[patch.row], self.column_windows[patch.column]).astype(np.float32)

    def crop(self, image: NDArray[Number], patch: Patch) -> NDArray[Number]:
        """Returns a view of the pixels [..., size, size] that a patch covers in `image` [..., height, width]."""
        return image[..., patch.top : patch.top + self.size, patch.left : patch.left + self.size]

    def covering(self, matte: Float32) -> tuple[Patch, ...]:
        """Returns the patches that contain any of the matte [height, width].

        At every pixel of the matte the windows of these patches sum to 1.
        """
        return tuple(patch for patch in self.patches if self.crop(matte, patch).any())


class PatchSum:
    """Windowed sum of patches over a frame with the same bits in any order of `add`.

    Values must lie in [-1, 1]. Sums are 32-bit integers in steps of 2^-28 (4e-9).
    """

    def __init__(self, grid: PatchGrid, planes: int) -> None:
        self._grid = grid
        self._sum = np.zeros((planes, grid.height, grid.width), dtype=np.int32)

    def add(self, patch: Patch, values: Float32) -> None:
        """Adds `values` [planes, size, size] in [-1, 1] times the window of the patch."""
        weighted = values.astype(np.float64) * self._grid.window(patch)
        self._grid.crop(self._sum, patch)[...] += np.rint(weighted * _FIXED_POINT).astype(np.int32)

    def value(self) -> Float32:
        """Returns the sum [planes, height, width] as float32."""
        value = self._sum.astype(np.float32)
        value *= np.float32(1.0 / _FIXED_POINT)  # a power of two, so the product is exact
        return value
