"""What a film does that a G-buffer read at pixel centres does not know: each pixel averages light around it.

A renderer's or a camera's pixel is the mean over a filter wider than itself (Cycles' Blackman-Harris of width 1.5
reaches over 3 pixels). Normals and depths that were averaged by the same filter bring that with them, and are short
where they mix; those read at pixel centres are of unit length everywhere, and light computed from them is sharper than
the plate: then it is averaged here, coverage by coverage, so that nothing outside the matte takes part.

Paint has been through the plate's own filter, and would be blurred twice: on one surface only the light that falls on
it is averaged. Where surfaces or metals meet, a pixel of the plate holds paint of both, and all is averaged.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

_WHOLE = 0.98  # length from which a normal is one direction, not the mean of several 20 degrees apart: half keeps 1e-3
_MISSING = 1e-12  # squared length up to which a normal is none
_FEW = 0.01  # share of shorter normals up to which they count as read at pixel centres: none in these, 0.29 in averaged
_BENT = 0.5  # range of normals over three by three pixels above which these are of two surfaces, or of a sharp bend
_METALS = 0.05  # range of metallic above which they are of two materials
_FAINT = 0.02  # paint below which light is not told by what it reflects


def short_normals(normal: NDArray[np.floating], covered: NDArray[np.bool_]) -> float:
    """Share of the covered pixels whose normal [H, W, 3] is an average of directions; missing normals do not count."""
    vectors = np.asarray(normal, dtype=np.float32)[covered]
    square = np.einsum("pc,pc->p", vectors, vectors)
    known = square > _MISSING  # and no NaN
    return float((square[known] < _WHOLE**2).mean()) if known.any() else 0.0


def read_at_centres(short: float) -> bool:
    """Whether that share of short normals says that the G-buffer was read at pixel centres."""
    return short <= _FEW


def film(image: F32, coverage: F32, side: float) -> F32:
    """Averages a straight image over the film's width; 0 where the coverage is 0.

    Light arrives in proportion to coverage, so that is what is averaged, with (side, 1 - 2 side, side) along rows and
    columns, and divided by the coverage averaged alike. A constant stays one up to the edge of the matte.

    Args:
        image: [H, W, C] straight, at least 0.
        coverage: [H, W] 0..1.
        side: share of each neighbour along an axis, half the variance of the filter in pixels^2: below 0.5.
    """
    average, found = _Average(coverage, side), np.empty(image.shape, dtype=np.float32)
    for channel in range(image.shape[-1]):  # one after another: at 4K each temporary is 33 MB
        found[..., channel] = average(image[..., channel])
    return found


def film_of_light(image: F32, paint: F32, meeting: NDArray[np.bool_], coverage: F32, side: float) -> F32:
    """As `film`, but what the paint multiplies is averaged, and the paint is not; where surfaces meet both are.

    Args:
        image: [H, W, 3] straight, at least 0; light times paint.
        paint: [H, W, 3] in [0, 1].
        meeting: [H, W] see `meetings`.
        coverage: [H, W] 0..1.
        side: as for `film`.
    """
    average, found = _Average(coverage, side), np.empty(image.shape, dtype=np.float32)
    for channel in range(image.shape[-1]):
        lit, whole = image[..., channel], np.maximum(paint[..., channel], np.float32(_FAINT))
        found[..., channel] = np.where(meeting, average(lit), average(lit / whole) * whole)
    return found


def meetings(normal: NDArray[np.floating], metallic: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[H, W] where two surfaces or a metal and something else lie within three by three pixels.

    Args:
        normal: [H, W, 3] finite; 0 beyond the matte, so that its edge is a meeting too.
        metallic: [H, W].
    """
    bend = sum(_range(normal[..., axis]) ** 2 for axis in range(3))
    return np.asarray((bend > _BENT**2) | (_range(metallic) > _METALS))


def _range(plane: NDArray[np.floating]) -> F32:
    plane, box = np.asarray(plane, dtype=np.float32), np.ones((3, 3), dtype=np.uint8)
    return np.asarray(cv2.dilate(plane, box) - cv2.erode(plane, box), dtype=np.float32)


class _Average:
    """Averages planes [H, W] by coverage [H, W]."""

    def __init__(self, coverage: F32, side: float) -> None:
        self._weight, self._side = np.asarray(coverage, dtype=np.float32), side
        self._total = _spread(self._weight, side)

    def __call__(self, plane: NDArray[np.floating]) -> F32:
        light = _spread((plane * self._weight).astype(np.float32), self._side)
        return np.divide(light, self._total, out=np.zeros_like(light), where=self._weight > 0)


def _spread(image: F32, side: float) -> F32:
    """Convolves [H, W] with (side, 1 - 2 side, side) along both axes; 0 beyond the border."""
    for axis in (0, 1):
        given = np.float32(side) * image
        image = np.float32(1 - 2 * side) * image
        ahead, behind = np.moveaxis(image, axis, 0), np.moveaxis(given, axis, 0)
        ahead[1:] += behind[:-1]
        ahead[:-1] += behind[1:]
    return image
