"""Rays of the camera through four parts of each pixel of the set, so that edges on it are soft."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.brdf import COS_MIN
from yesnt.relight.points import Pixels

F32 = NDArray[np.float32]

PARTS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""Middles of the four parts of a pixel, from its own."""


class RayGrid(NamedTuple):
    """Where R rays stand in a picture that has one place for each part of a pixel, so that neighbours are found.

    Attributes:
        place: [R] flat.
        shape: (2 H, 2 W).
        footprint: [R] metres between the points that rays of neighbouring places meet.
    """

    place: NDArray[np.int64]
    shape: tuple[int, int]
    footprint: F32


class PixelParts(NamedTuple):
    """The parts of P pixels.

    Attributes:
        eye: [3] the camera's place, world metres.
        rays: [4, P, 3] world directions through the parts, of any length.
    """

    eye: F32
    rays: F32

    def seen(self, pixels: Pixels, part: int, some: NDArray[np.intp]) -> tuple[F32, F32]:
        """Where the rays of one part meet the planes of pixels [n], and their unit directions, both [n, 3].

        A ray that does not meet the plane from above is as long as that through the middle of its pixel.
        """
        aim = self.rays[part][some].astype(np.float64)
        aim /= np.linalg.norm(aim, axis=1, keepdims=True)
        middle = pixels.position[some] - self.eye
        slope, level = ((a * pixels.normal[some]).sum(axis=1) for a in (aim, middle))
        meets = slope < -COS_MIN
        along = np.where(meets, level / np.where(meets, slope, 1), np.linalg.norm(middle, axis=1))
        return (self.eye + aim * along[:, None]).astype(np.float32), aim.astype(np.float32)

    def spacing(self, which: NDArray[np.intp]) -> F32:
        """Angle [n], rad, between the rays of neighbouring pixels: twice that between the two upper parts of one."""
        first, second = (self.rays[k][which] for k in (0, 1))
        apart = first / np.linalg.norm(first, axis=1, keepdims=True)
        apart = apart - second / np.linalg.norm(second, axis=1, keepdims=True)
        return np.asarray(2 * np.linalg.norm(apart, axis=1), np.float32)

    def grid(self, pixels: Pixels, which: NDArray[np.intp], part: NDArray[np.intp], travelled: F32) -> RayGrid:
        """The places of rays [R] through parts [R] of pixels `which` [R]; `travelled` [R], metres from the eye."""
        row, column = np.divmod(pixels.index[which], pixels.shape[1])
        right, down = part % 2, part // 2
        height, width = pixels.shape
        place = (2 * row + down) * 2 * width + 2 * column + right
        return RayGrid(place, (2 * height, 2 * width), (0.5 * travelled * self.spacing(which)).astype(np.float32))
