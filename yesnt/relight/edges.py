"""Pixels that hold two surfaces: antialiasing averages normals and colours, but shading is not linear in the normal.

Such a pixel is known by its short averaged normal. It is explained as a mixture of two clean pixels beside it, the pair
that fits its guide colour and normal best, and takes their light in that proportion while it keeps its own detail:
    light = guide (a R_1 + (1-a) R_2) / (a G_1 + (1-a) G_2)  per channel.
That estimate and the pixel's own shading err independently; their mean is better than either (docs/relight.md).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

F32 = NDArray[np.float32]

RADIUS = 2
"""Pixels that are searched for clean neighbours: antialiasing spreads an edge over at most two."""

_MIXED = 0.9  # length of an averaged normal below which two parts differ by more than about 50 degrees
_CLEAN = 0.95  # above it a pixel is one surface, or a curved one
_SEAM = 0.5  # of metallic across a pixel: less is a material of its own
_PURE = 0.05  # of metallic: nearer to a neighbour than this a pixel is all of that neighbour's material
_COLOUR = 2.0  # weight of a unit of guide colour against a unit of normal in the fit
_NEARNESS = 0.002  # cost of a squared pixel of distance in the fit
_GAIN = 2.0  # bound on the detail ratio: beyond, the neighbours do not explain the pixel


def resolve_edges(layers: F32, guide: F32, normal: F32, metallic: F32, covered: NDArray[np.bool_]) -> F32:
    """Returns the layers [K, H, W, 3] with mixed pixels resolved; all others are untouched.

    Args:
        layers: lit images that share one mixture.
        guide: [H, W, 3] straight colour that the camera saw, or the base colour.
        normal: [H, W, 3] as averaged by the renderer, not normalised; unit normals resolve nothing.
        metallic: [H, W] as averaged by the renderer: between 0 and 1 beside both, it marks a seam of metal.
        covered: [H, W] which pixels are lit.
    """
    length = np.linalg.norm(normal, axis=-1)
    seam = covered & _seams(metallic, covered)
    rows, columns = np.nonzero(covered & (length > 1e-6) & ((length < _MIXED) | seam))
    result = np.array(layers, dtype=np.float32, order="C")
    if len(rows):
        features = np.concatenate([np.float32(_COLOUR) * guide, normal, metallic[..., None]], axis=-1)
        clean = covered & (length > _CLEAN) & ~seam
        _resolve(np.ascontiguousarray(layers), features.astype(np.float32), clean, rows, columns, result)
    return result


def _seams(metallic: F32, covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels whose metallic lies between those of their neighbours [H, W], where these differ by more than half."""
    from scipy.ndimage import maximum_filter, minimum_filter

    least = minimum_filter(np.where(covered, metallic, 1), 3)
    most = maximum_filter(np.where(covered, metallic, 0), 3)
    return (most - least > _SEAM) & (metallic > least + _PURE) & (metallic < most - _PURE)


@njit(cache=True, parallel=True, error_model="numpy")
def _resolve(layers, features, clean, rows, columns, result):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    for i in prange(rows.shape[0]):
        y, x = rows[i], columns[i]
        y1, x1, y2, x2, share = _best_pair(features, clean, y, x)
        for c in range(3 if y1 >= 0 else 0):
            seen = share * features[y1, x1, c] + (1 - share) * features[y2, x2, c]
            gain = features[y, x, c] / max(seen, np.float32(1e-3))
            gain = min(max(gain, np.float32(1 / _GAIN)), np.float32(_GAIN))
            for k in range(layers.shape[0]):
                light = share * layers[k, y1, x1, c] + (1 - share) * layers[k, y2, x2, c]
                result[k, y, x, c] = np.float32(0.5) * (layers[k, y, x, c] + gain * light)


@njit(cache=True, error_model="numpy")
def _best_pair(features, clean, y, x):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Two clean pixels near (y, x) and the share of the first that fit it best; -1 where there are fewer than two."""
    around = np.empty(((2 * RADIUS + 1) ** 2, 2), dtype=np.int64)
    count = 0
    for j in range(max(0, y - RADIUS), min(clean.shape[0], y + RADIUS + 1)):
        for i in range(max(0, x - RADIUS), min(clean.shape[1], x + RADIUS + 1)):
            if clean[j, i]:
                around[count, 0], around[count, 1] = j, i
                count += 1
    best = np.float32(np.inf)
    y1, x1, y2, x2, share = -1, -1, -1, -1, np.float32(1)
    for first in range(count):
        for second in range(first):
            j1, i1, j2, i2 = around[first, 0], around[first, 1], around[second, 0], around[second, 1]
            a, error = _fit(features[y, x], features[j1, i1], features[j2, i2])
            far1, far2 = (j1 - y) ** 2 + (i1 - x) ** 2, (j2 - y) ** 2 + (i2 - x) ** 2
            error += np.float32(_NEARNESS) * (a * far1 + (1 - a) * far2)
            if error < best:
                best, share = error, a
                y1, x1, y2, x2 = j1, i1, j2, i2
    return y1, x1, y2, x2, share


@njit(cache=True, error_model="numpy")
def _fit(target, one, two):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The a in [0, 1] that brings a one + (1-a) two closest to the target, and the squared distance left."""
    dot, square = np.float32(0), np.float32(1e-6)
    for c in range(target.shape[0]):
        across = one[c] - two[c]
        dot += (target[c] - two[c]) * across
        square += across * across
    a = min(max(dot / square, np.float32(0)), np.float32(1))
    error = np.float32(0)
    for c in range(target.shape[0]):
        error += (target[c] - a * one[c] - (1 - a) * two[c]) ** 2
    return a, error
