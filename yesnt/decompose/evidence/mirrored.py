"""How much of what a point shows towards a camera comes from the subject itself.

Radiance from there is known as the mean over a triangle of the proxy (triangles.py), so that a sharp lobe is predicted
worse there than in the open. Without this term a mirror among other objects is taken for a blunt surface.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.compiled import exact_entry
from yesnt.relight.proxy import OPEN
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]
_OPEN = int(OPEN)


def occluded_share(
    normal: F32, towards: F32, hits: NDArray[np.int32], clusters: tuple[F32, F32], sharpness: float
) -> F32:
    """Share [P] of the lobe exp(sharpness (w.l - 1)) about the mirrored view w that the subject itself fills.

    Args:
        normal: [P, 3] unit.
        towards: [P, 3] unit directions to the camera.
        hits: [P, C] triangle towards each light cluster, OPEN where there is none.
        clusters: their directions [3, C] and solid angles [C].
        sharpness: exponent of the lobe.
    """
    out = np.zeros(len(normal), dtype=np.float32)
    over_ranges(len(normal), lambda a, b: _shares(a, b, normal, towards, hits, clusters, sharpness, out))
    return out


@exact_entry
def _shares(first, last, normal, towards, hits, clusters, sharpness, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the shares of points [first, last)."""
    direction, solid = clusters
    for p in range(first, last):
        cosine = 0.0
        for k in range(3):
            cosine += normal[p, k] * towards[p, k]
        total = blocked = 0.0
        for c in range(solid.shape[0]):
            along = 0.0
            for k in range(3):
                along += (2.0 * cosine * normal[p, k] - towards[p, k]) * direction[k, c]
            weight = solid[c] * math.exp(sharpness * (along - 1.0))
            total += weight
            if hits[p, c] != _OPEN:
                blocked += weight
        out[p] = blocked / total if total > 0 else 0.0
