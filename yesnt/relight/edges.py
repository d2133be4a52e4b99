"""Pixels that mix two surfaces: antialiasing averages normals and colours, but shading is not linear in the normal.

Such a pixel has a short averaged normal. It is explained as a mixture of two clean pixels near it, the pair that fits
its guide colour and normal best. It takes their light in that proportion and keeps its own detail:
    light = guide (a R_1 + (1-a) R_2) / (a G_1 + (1-a) G_2)  per channel,
with R the light and G the guide colour of both. The errors of that estimate and of the pixel's own shading are
independent; their mean is better than either (docs/relight.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.compiled import exact_entry, exact_kernel
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]

RADIUS = 2
"""Distance, pixels, in which clean neighbours are searched: antialiasing spreads an edge over at most two."""

_MIXED = 0.9  # length of an averaged normal below which its parts differ by more than about 50 degrees
_CLEAN = 0.95  # length above which a pixel is one surface, flat or curved
_SEAM = 0.5  # least range of metallic across a seam: less is a material of its own
_PURE = 0.05  # difference of metallic up to which a pixel is wholly of its neighbour's material
_COLOUR = 2.0  # weight of a unit of guide colour against a unit of normal in the fit
_NEARNESS = 0.002  # cost of a squared pixel of distance in the fit
_GAIN = 2.0  # bound on the ratio of detail: beyond, the neighbours do not explain the pixel


class MixedPixels(NamedTuple):
    """Places of M pixels that mix two surfaces.

    Attributes:
        rows: [M].
        columns: [M].
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]


def resolve_edges(layers: F32, guide: F32, normal: F32, metallic: F32, covered: NDArray[np.bool_]) -> F32:
    """Returns a copy of the layers in which mixed pixels are resolved; all others are unchanged.

    Args:
        layers: [K, H, W, 3] radiance images that share one mixture.
        guide: [H, W, 3] straight colour that the camera saw, or the base colour.
        normal: [H, W, 3] as averaged by the renderer, not normalised; unit normals resolve nothing.
        metallic: [H, W] as averaged by the renderer; a value between those on both sides marks a seam of metal.
        covered: [H, W] which pixels are lit.
    """
    length = np.linalg.norm(normal, axis=-1)
    seam = covered & _seams(metallic, covered)
    mixed = MixedPixels(*np.nonzero(covered & (length > 1e-6) & ((length < _MIXED) | seam)))
    result = np.array(layers, dtype=np.float32, order="C")
    if len(mixed.rows):
        features = np.concatenate([np.float32(_COLOUR) * guide, normal, metallic[..., None]], axis=-1)
        features, clean = features.astype(np.float32), covered & (length > _CLEAN) & ~seam
        given = np.ascontiguousarray(layers)
        over_ranges(
            len(mixed.rows), lambda first, last: _resolve(first, last, mixed, given, features, clean, result)
        )  # fmt: skip
    return result


def _seams(metallic: F32, covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """[H, W] pixels whose metallic lies between those of their neighbours, where these differ by more than half."""
    from scipy.ndimage import maximum_filter, minimum_filter

    least = minimum_filter(np.where(covered, metallic, 1), 3)
    most = maximum_filter(np.where(covered, metallic, 0), 3)
    return (most - least > _SEAM) & (metallic > least + _PURE) & (metallic < most - _PURE)


@exact_entry
def _resolve(first, last, mixed, layers, features, clean, result):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the light of mixed pixels [first, last) to `result` [K, H, W, 3]."""
    for i in range(first, last):
        y, x = mixed.rows[i], mixed.columns[i]
        y1, x1, y2, x2, share = _best_pair(features, clean, y, x)
        for c in range(3 if y1 >= 0 else 0):
            guide = share * features[y1, x1, c] + (1 - share) * features[y2, x2, c]
            gain = features[y, x, c] / max(guide, np.float32(1e-3))
            gain = min(max(gain, np.float32(1 / _GAIN)), np.float32(_GAIN))
            for k in range(layers.shape[0]):
                light = share * layers[k, y1, x1, c] + (1 - share) * layers[k, y2, x2, c]
                result[k, y, x, c] = np.float32(0.5) * (layers[k, y, x, c] + gain * light)


@exact_kernel
def _best_pair(features, clean, y, x):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Places of two clean pixels near (y, x) and the share of the first that fit it best; -1 if there are fewer.

    Pairs are tried in the order of the rows and columns of the square of radius RADIUS about the pixel.
    """
    side = 2 * RADIUS + 1
    best = np.float32(np.inf)
    y1, x1, y2, x2, share = -1, -1, -1, -1, np.float32(1)
    for first in range(side * side):
        j1, i1 = y - RADIUS + first // side, x - RADIUS + first % side
        if not _is_clean(clean, j1, i1):
            continue
        for second in range(first):
            j2, i2 = y - RADIUS + second // side, x - RADIUS + second % side
            if not _is_clean(clean, j2, i2):
                continue
            a, error = _fit(features, y, x, (j1, i1), (j2, i2))
            far1, far2 = (j1 - y) ** 2 + (i1 - x) ** 2, (j2 - y) ** 2 + (i2 - x) ** 2
            error += np.float32(_NEARNESS) * (a * far1 + (1 - a) * far2)
            if error < best:
                best, share = error, a
                y1, x1, y2, x2 = j1, i1, j2, i2
    return y1, x1, y2, x2, share


@exact_kernel
def _is_clean(clean, y, x):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether a place lies in the image and is a pixel of one surface."""
    return 0 <= y < clean.shape[0] and 0 <= x < clean.shape[1] and clean[y, x]


@exact_kernel
def _fit(features, y, x, one, two):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The a in [0, 1] that brings a F[one] + (1-a) F[two] closest to F[y, x], and the squared distance that is left."""
    y1, x1 = one
    y2, x2 = two
    dot, square = np.float32(0), np.float32(1e-6)
    for c in range(features.shape[2]):
        across = features[y1, x1, c] - features[y2, x2, c]
        dot += (features[y, x, c] - features[y2, x2, c]) * across
        square += across * across
    a = min(max(dot / square, np.float32(0)), np.float32(1))
    error = np.float32(0)
    for c in range(features.shape[2]):
        error += (features[y, x, c] - a * features[y1, x1, c] - (1 - a) * features[y2, x2, c]) ** 2
    return a, error
