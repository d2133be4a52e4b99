"""A frame prepared for patch-wise sampling: checked, padded, with its patches and its global context."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from yesnt.decompose.backend import Backend, GlobalPredictor
from yesnt.decompose.blend import Patch, PatchGrid
from yesnt.decompose.global_context import ContextBatch, Square, context_image

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class PaddedFrame:
    """A frame padded to at least one patch.

    Attributes:
        grid: patches that cover the padded frame [H, W].
        rgb: [3, H, W] straight linear Rec.709, 0 outside the matte.
        matte: [H, W] coverage in [0, 1].
        shape: rows and columns before padding.
        square: square around the subject that the context shows.
        context: [4, CONTEXT_SIDE, CONTEXT_SIDE] straight rgb and matte of the subject.
        backend: sampler that the frame is prepared for.
    """

    grid: PatchGrid
    rgb: Float32
    matte: Float32
    shape: tuple[int, ...]
    square: Square
    context: Float32
    backend: Backend

    @classmethod
    def prepare(cls, rgb: Float32, matte: Float32, backend: Backend, overlap: float) -> PaddedFrame:
        """Checks a frame, pads it and places its patches.

        Args:
            rgb: [H, W, 3] linear Rec.709, straight.
            matte: [H, W] coverage in [0, 1].
            backend: the sampler.
            overlap: least overlap of neighbouring patches as a fraction of their side.

        Raises:
            ValueError: shapes disagree, or a value inside the matte is not finite.
        """
        if rgb.shape != (*matte.shape, 3):
            raise ValueError(f"rgb {rgb.shape} must be [H, W, 3] of the matte's [H, W] {matte.shape}")
        inside = matte > 0
        if not np.isfinite(rgb[inside]).all():
            raise ValueError("rgb holds NaN or Inf inside the matte")
        grid = PatchGrid.cover(matte.shape[0], matte.shape[1], backend.patch, overlap, backend.align)
        pad = ((0, grid.height - matte.shape[0]), (0, grid.width - matte.shape[1]))
        clean = np.where(inside[..., None], rgb, 0).astype(np.float32)
        planes, cover = clean.transpose(2, 0, 1), matte.astype(np.float32)
        square = Square.around(cover)
        context = context_image(planes, cover, square)
        return cls(grid, np.pad(planes, ((0, 0), *pad)), np.pad(cover, pad), matte.shape, square, context, backend)

    @cached_property
    def auxiliary(self) -> torch.Tensor | None:
        """Auxiliary features of the whole subject [1, C, s, s], predicted once, when a patch is sampled."""
        if not isinstance(self.backend, GlobalPredictor) or not self.backend.auxiliary_side:
            return None
        image = context_image(self.rgb, self.matte, self.square, self.backend.auxiliary_side)
        return self.backend.predict_auxiliary(torch.from_numpy(image)[None])

    def encode(self, patches: Sequence[Patch]) -> torch.Tensor:
        """Encodes up to `backend.batch` patches; rows without a patch hold zeros."""
        rows = self.backend.batch
        return self.backend.encode(
            crop_batch(self.grid, self.rgb, patches, rows),
            crop_batch(self.grid, self.matte[None], patches, rows),
            self._context_batch(patches, rows),
        )

    def unpad(self, planes: NDArray[np.floating]) -> Float32:
        """Returns planes [..., H, W] without the padding and 0 outside the matte."""
        rows, columns = self.shape
        return np.where(self.matte > 0, planes, 0)[..., :rows, :columns].astype(np.float32, order="C")

    def _context_batch(self, patches: Sequence[Patch], rows: int) -> ContextBatch:
        """Global context of `rows` rows; rows without a patch have the location (0, 0, 0)."""
        locations = np.zeros((rows, 3), np.float32)
        locations[: len(patches)] = [self.square.locate(p.top, p.left, self.grid.size) for p in patches]
        auxiliary = None if self.auxiliary is None else self.auxiliary.expand(rows, -1, -1, -1)
        image = torch.from_numpy(self.context).expand(rows, -1, -1, -1)
        return ContextBatch(image, torch.from_numpy(locations), auxiliary)


def crop_batch(grid: PatchGrid, image: Float32, patches: Sequence[Patch], rows: int) -> torch.Tensor:
    """Crops patches of an image [C, H, W] to [rows, C, P, P]; missing rows are 0, so that every batch has one shape."""
    batch = np.zeros((rows, image.shape[0], grid.size, grid.size), dtype=np.float32)
    for row, patch in enumerate(patches):
        batch[row] = grid.crop(image, patch)
    return torch.from_numpy(batch)
