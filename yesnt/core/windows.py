"""Windows of pictures: where the stored pixels lie (data window) on the picture that is meant (display window)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels; x to the right, y down. OpenEXR's boxes include their last pixel, `right` does not.

    Attributes:
        left: first column; may be negative.
        top: first row.
        width: columns.
        height: rows.
    """

    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """The column after the last."""
        return self.left + self.width

    @property
    def bottom(self) -> int:
        """The row after the last."""
        return self.top + self.height

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.width, self.height

    def moved(self, x: int, y: int) -> Window:
        """The same rectangle further right and down."""
        return Window(self.left + x, self.top + y, self.width, self.height)

    def united(self, other: Window) -> Window:
        """The smallest window that holds both."""
        left, top = min(self.left, other.left), min(self.top, other.top)
        return Window(left, top, max(self.right, other.right) - left, max(self.bottom, other.bottom) - top)

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at ({self.left}, {self.top})"


def union(windows: Iterable[Window]) -> Window:
    """The smallest window that holds all of at least one."""
    return reduce(Window.united, windows)


def place(plane: NDArray[np.float32], stored: Window, wanted: Window) -> NDArray[np.float32]:
    """A plane of the window `stored`, [H, W, ...], as the window `wanted` sees it; 0 where nothing is stored."""
    if stored == wanted:
        return plane
    out = np.zeros((wanted.height, wanted.width, *plane.shape[2:]), plane.dtype)
    left, right = max(stored.left, wanted.left), min(stored.right, wanted.right)
    top, bottom = max(stored.top, wanted.top), min(stored.bottom, wanted.bottom)
    if left < right and top < bottom:
        seen = plane[top - stored.top : bottom - stored.top, left - stored.left : right - stored.left]
        out[top - wanted.top : bottom - wanted.top, left - wanted.left : right - wanted.left] = seen
    return out


@dataclass(frozen=True)
class Raster:
    """The pixels of a shot, where they are not simply those of the camera; windows as the plates' headers have them.

    Attributes:
        display: display window of the plates; all inputs are aligned by its corner.
        processed: what is processed and delivered: the smallest window that holds it and the data of all plates.
        camera: what the camera's width and height describe: the display window, or the data window of all plates.
        aspect: width of a pixel over its height.
        rate: frames per second as numerator and denominator; None: the plates do not say.
        metadata: names of the plates' attributes that the delivered files carry on.
        readings: formats of plates and how they were read, where that is not premultiplied EXR.
    """

    display: Window
    processed: Window
    camera: Window
    aspect: float = 1.0
    rate: tuple[int, int] | None = None
    metadata: tuple[str, ...] = ()
    readings: tuple[str, ...] = ()

    @property
    def data(self) -> Window:
        """What is processed, counted from the display window's corner."""
        return self.processed.moved(-self.display.left, -self.display.top)
