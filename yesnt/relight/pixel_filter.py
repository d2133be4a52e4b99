"""Pixel filter (reconstruction filter): each pixel of a plate is a mean of the light around its centre.

The filter of a renderer or camera is wider than a pixel (Blackman-Harris of width 1.5, Cycles' default, reaches over 3
pixels). A G-buffer whose normals and depths have been through that filter has short normals where it mixes surfaces. A
G-buffer sampled at pixel centres has unit normals everywhere, and light computed from it is sharper than the plate.
Then the light is filtered here, weighted by coverage, so that nothing outside the matte takes part.

The plate's base colour has been through the filter already and would be blurred twice. So on one surface only the
light that falls on it is filtered. Where surfaces or materials meet, a pixel of the plate mixes both, and the product
of light and base colour is filtered. Source: docs/relight.md.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

_WHOLE = (
    0.98  # least length of one direction; the mean of directions 20 degrees apart is shorter; half floats keep 1e-3
)
_MISSING = 1e-12  # squared length up to which a normal is missing
_FEW = 0.01  # share of short normals up to which a G-buffer was sampled at pixel centres: 0 in those, 0.29 in filtered
_BENT = 0.5  # range of normals over 3 x 3 pixels above which these are of two surfaces, or of a sharp bend
_METALS = 0.05  # range of metallic over 3 x 3 pixels above which these are of two materials
_FAINT = 0.02  # base colour below which reflected light does not tell the incident light


def short_normals(normal: NDArray[np.floating], covered: NDArray[np.bool_]) -> float:
    """Share of the covered pixels [H, W] whose normal [H, W, 3] is shorter than 0.98, a mean of several directions.

    Missing normals (0 or NaN) do not count; 0 if all are missing.
    """
    vectors = np.asarray(normal, dtype=np.float32)[covered]
    square = np.einsum("pc,pc->p", vectors, vectors)
    known = square > _MISSING  # and no NaN
    return float((square[known] < _WHOLE**2).mean()) if known.any() else 0.0


def read_at_centres(short: float) -> bool:
    """Whether the G-buffer was sampled at pixel centres, from its share of `short_normals`."""
    return short <= _FEW


def filter_pixels(image: F32, coverage: F32, side: float) -> F32:
    """Filters a straight image; 0 where the coverage is 0.

    Image times coverage is convolved with (side, 1 - 2 side, side) along rows and columns and divided by the coverage
    convolved alike. A constant image stays constant up to the edge of the matte.

    Args:
        image: [H, W, C] straight radiance, at least 0.
        coverage: [H, W] 0..1.
        side: weight of each neighbour along an axis, half the variance of the filter in pixels^2: below 0.5.
    """
    average, found = _Average(coverage, side), np.empty(image.shape, dtype=np.float32)
    for channel in range(image.shape[-1]):  # one after another: at 4K each temporary is 33 MB
        found[..., channel] = average(image[..., channel])
    return found


def filter_light(image: F32, base_color: F32, boundary: NDArray[np.bool_], coverage: F32, side: float) -> F32:
    """Filters the light and not the base colour that multiplies it; at boundaries, the product of both.

    Args:
        image: [H, W, 3] straight radiance, at least 0; light times base colour.
        base_color: [H, W, 3] in [0, 1].
        boundary: [H, W] of `boundaries`.
        coverage: [H, W] 0..1.
        side: as for `filter_pixels`.
    """
    average, found = _Average(coverage, side), np.empty(image.shape, dtype=np.float32)
    for channel in range(image.shape[-1]):
        lit, whole = image[..., channel], np.maximum(base_color[..., channel], np.float32(_FAINT))
        found[..., channel] = np.where(boundary, average(lit), average(lit / whole) * whole)
    return found


def boundaries(normal: NDArray[np.floating], metallic: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[H, W] True where two surfaces, or a metal and another material, lie within 3 x 3 pixels.

    Args:
        normal: [H, W, 3] finite; 0 outside the matte, so that its edge is a boundary too.
        metallic: [H, W].
    """
    bend = sum(_range(normal[..., axis]) ** 2 for axis in range(3))
    return np.asarray((bend > _BENT**2) | (_range(metallic) > _METALS))


def _range(plane: NDArray[np.floating]) -> F32:
    """Largest minus smallest value over 3 x 3 pixels, [H, W]."""
    plane, box = np.asarray(plane, dtype=np.float32), np.ones((3, 3), dtype=np.uint8)
    return np.asarray(cv2.dilate(plane, box) - cv2.erode(plane, box), dtype=np.float32)


class _Average:
    """Filters planes [H, W] weighted by one coverage [H, W]."""

    def __init__(self, coverage: F32, side: float) -> None:
        self._weight, self._side = np.asarray(coverage, dtype=np.float32), side
        self._total = spread(self._weight, side)

    def __call__(self, plane: NDArray[np.floating]) -> F32:
        light = spread((plane * self._weight).astype(np.float32), self._side)
        return np.divide(light, self._total, out=np.zeros_like(light), where=self._weight > 0)


def spread(image: F32, side: float) -> F32:
    """Convolves [H, W] with (side, 1 - 2 side, side) along both axes; 0 beyond the border."""
    for axis in (0, 1):
        given = np.float32(side) * image
        image = np.float32(1 - 2 * side) * image
        ahead, behind = np.moveaxis(image, axis, 0), np.moveaxis(given, axis, 0)
        ahead[1:] += behind[:-1]
        ahead[:-1] += behind[1:]
    return image
