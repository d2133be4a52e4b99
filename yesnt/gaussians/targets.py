"""What a fit compares its pictures with: plates and mattes cropped to the subject, and what the losses need of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.gaussians.records import View

F32 = NDArray[np.float32]

MARGIN = 8
"""Pixels around the matte that stay in the crop: opacity there is pushed down."""

INSIDE = 0.99
"""Coverage above which a pixel shows the subject alone."""

_SEEN = 0.02  # coverage that counts as the subject when the crop is chosen


@dataclass(frozen=True)
class Target:
    """A camera's picture of the subject, cropped to its matte.

    Attributes:
        view: the crop's camera.
        color: [H, W, 3] associated colour on black in the field's colour space.
        matte: [H, W] coverage in [0, 1].
        pixels: sum of the matte; losses are means over it.
    """

    view: View
    color: F32
    matte: F32
    pixels: float

    @classmethod
    def cropped(cls, view: View, color: F32, matte: F32, margin: int = MARGIN) -> Target:
        """The target of a whole picture; sides of the crop are even, so that it can be halved.

        Raises:
            JobError: the matte is empty, or a value is not finite.
        """
        if not (np.isfinite(color).all() and np.isfinite(matte).all()):
            raise JobError("A picture for the fit of a Gaussian field is not finite everywhere", "plate or matte")
        rows, columns = (np.flatnonzero((matte > _SEEN).any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            raise JobError(
                "A matte for the fit of a Gaussian field is empty", "matte",
                "the subject in the picture of every camera", "leave the camera out, or mend its matte",
            )  # fmt: skip
        top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
        height = min(rows[-1] + margin + 1, view.height) - top
        width = min(columns[-1] + margin + 1, view.width) - left
        height, width = max(height // 2 * 2, 2), max(width // 2 * 2, 2)
        part = (slice(top, top + height), slice(left, left + width))
        cut = np.ascontiguousarray(matte[part], np.float32)
        return cls(
            view.window(int(left), int(top), int(width), int(height)),
            np.ascontiguousarray(color[part], np.float32), cut, float(cut.sum()),
        )  # fmt: skip

    def halved(self) -> Target:
        """The same picture with pixels twice as wide, each the mean of four."""
        h, w = self.matte.shape[0] // 2 * 2, self.matte.shape[1] // 2 * 2

        def half(image: F32) -> F32:
            return np.ascontiguousarray(
                0.25 * (image[0:h:2, 0:w:2] + image[1:h:2, 0:w:2] + image[0:h:2, 1:w:2] + image[1:h:2, 1:w:2])
            )

        matte = half(self.matte)
        return replace(self, view=self.view.halved(), color=half(self.color), matte=matte, pixels=float(matte.sum()))
