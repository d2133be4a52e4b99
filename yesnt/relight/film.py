"""What a film does that a G-buffer read at pixel centres does not know: each pixel averages light around it.

A renderer's or a camera's pixel is the mean over a filter wider than itself (Cycles' Blackman-Harris of width 1.5
reaches over 3 pixels). Normals and depths that were averaged by the same filter bring that with them, and are short
where they mix; those read at pixel centres are of unit length everywhere, and light computed from them is sharper than
the plate: then it is averaged here, coverage by coverage, so that nothing outside the matte takes part.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

_WHOLE = 0.98  # length from which a normal is one direction, not the mean of several 20 degrees apart: half keeps 1e-3
_MISSING = 1e-12  # squared length up to which a normal is none
_FEW = 0.01  # share of shorter normals up to which they count as read at pixel centres: none in these, 0.29 in averaged


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
    weight = np.asarray(coverage, dtype=np.float32)
    inside, total = weight > 0, _spread(weight, side)
    found = np.zeros(image.shape, dtype=np.float32)
    for channel in range(image.shape[-1]):  # one after another: at 4K each temporary is 33 MB
        light = _spread(image[..., channel] * weight, side)
        np.divide(light, total, out=found[..., channel], where=inside)
    return found


def _spread(image: F32, side: float) -> F32:
    """Convolves [H, W] with (side, 1 - 2 side, side) along both axes; 0 beyond the border."""
    for axis in (0, 1):
        given = np.float32(side) * image
        image = np.float32(1 - 2 * side) * image
        ahead, behind = np.moveaxis(image, axis, 0), np.moveaxis(given, axis, 0)
        ahead[1:] += behind[:-1]
        ahead[:-1] += behind[1:]
    return image
