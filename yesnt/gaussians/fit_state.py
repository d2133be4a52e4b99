"""What a fit knows between two steps, as arrays that can be kept and taken up again to the same bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.field import ARRAYS, ColorSpace, GaussianField
from yesnt.gaussians.project import GaussianArrays

F32 = NDArray[np.float32]

FITTED = tuple(name for name in ARRAYS if name != "filter_3d")
"""Arrays of a field that are fitted."""


@dataclass
class FitState:
    """A fit after `step` steps.

    Attributes:
        values: the arrays of the field; quaternions are not normalised.
        means, squares: Adam's moments of the same shapes.
        screen, seen: [N] sums of the screen gradient's length, and views that had one, since the last splitting.
        height: of the subject, metres.
        pixel: width of a pixel at the subject, metres.
        step: steps done.
        best: best held-out PSNR so far, dB.
        stale: looks since then.
        color_space: of the pictures.
    """

    values: dict[str, F32]
    means: dict[str, F32]
    squares: dict[str, F32]
    screen: F32
    seen: F32
    height: float
    pixel: float
    step: int = 0
    best: float = -np.inf
    stale: int = 0
    color_space: ColorSpace = field(default="srgb")

    @classmethod
    def of(cls, start: GaussianField, height: float, pixel: float) -> FitState:
        """The state before the first step of a fit that starts from a field without a smoothing filter."""
        if start.filter_3d is not None:
            raise ValueError("a fit starts from a field without a smoothing filter")
        values = {name: np.array(getattr(start, name)) for name in FITTED}
        means, squares = ({name: np.zeros_like(value) for name, value in values.items()} for _ in range(2))
        screen, seen = np.zeros((2, start.count), np.float32)
        return cls(values, means, squares, screen, seen, height, pixel, color_space=start.color_space)

    @property
    def count(self) -> int:
        """Gaussians."""
        return len(self.screen)

    @property
    def arrays(self) -> GaussianArrays:
        """As the kernels take them."""
        return GaussianArrays(**self.values, added=np.zeros(self.count, np.float32))

    @property
    def gaussians(self) -> GaussianField:
        """The field, with unit quaternions."""
        q = self.values["rotations"].astype(np.float64)
        unit = q / np.linalg.norm(q, axis=1, keepdims=True)
        return GaussianField(**{**self.values, "rotations": unit}, color_space=self.color_space)

    def to_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Everything, for a checkpoint."""
        parts = {"values": self.values, "means": self.means, "squares": self.squares}
        named = {f"{part}.{name}": value for part, arrays in parts.items() for name, value in arrays.items()}
        numbers = np.array([self.height, self.pixel, self.step, self.best, self.stale], np.float64)
        space = np.array([self.color_space == "linear"])
        return {**named, "screen": self.screen, "seen": self.seen, "numbers": numbers, "linear": space}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> FitState:
        """The state of a checkpoint; the fit then continues to the same bits as without an interruption."""
        values, means, squares = (
            {name: np.array(arrays[f"{part}.{name}"], np.float32) for name in FITTED}
            for part in ("values", "means", "squares")
        )
        height, pixel, step, best, stale = (float(number) for number in np.asarray(arrays["numbers"], np.float64))
        screen, seen = (np.array(arrays[name], np.float32) for name in ("screen", "seen"))
        space: ColorSpace = "linear" if bool(arrays["linear"][0]) else "srgb"
        return cls(values, means, squares, screen, seen, height, pixel, int(step), best, int(stale), space)
