"""Directions towards a light in which the set looks for the subject.

They are the texels of the prepared light that relights the subject, cut into parts: a wide texel so that no part shows
as the edge of a shadow, a bright one so that a sun has a penumbra. The same for every pixel and every frame.
Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.lights import Clusters, PreparedLight

F32 = NDArray[np.float32]

WIDEST = 0.016
"""Largest solid angle of a part, sr: 7 degrees across."""

BRIGHTEST = 0.001
"""Largest share of the light in one part, where that takes no more than `MOST` parts along a side."""

MOST = 6
"""Parts along each side of a texel at most."""

STRONG = 0.02
"""Share of the light in one texel from which its shadow has an edge: it is looked for at every pixel."""


@dataclass(frozen=True)
class LightSamples:
    """The two kinds of directions; Clusters of reach 0.

    Attributes:
        strong: parts of texels with at least `STRONG` of the light.
        weak: parts of all others.
    """

    strong: Clusters
    weak: Clusters


@lru_cache(maxsize=4)
def light_samples(light: PreparedLight) -> LightSamples:
    """Samples of a light; made once per light."""
    real = light.texels.level(0)[6] > 0
    rows = light.texels.level(0)[:, real].astype(np.float64)
    share = luminance(light.undivided.texels.level(0)[3:6, real].T.astype(np.float64))
    share = share / max(float(share.sum()), 1e-30)
    sides = np.ceil(np.sqrt(np.maximum(rows[6] / WIDEST, share / BRIGHTEST)))
    sides = np.clip(sides, 1, MOST).astype(np.int64)
    strong = share >= STRONG
    return LightSamples(_parts(rows[:, strong], sides[strong]), _parts(rows[:, ~strong], sides[~strong]))


def _parts(rows: NDArray[np.float64], sides: NDArray[np.int64]) -> Clusters:
    """Cuts texels [8, T] into `sides` by `sides` equal parts of a square of their solid angle."""
    texel = np.repeat(np.arange(len(sides)), sides**2)
    number = np.arange(len(texel)) - np.repeat(np.cumsum(sides**2) - sides**2, sides**2)
    side = sides[texel]
    width = np.sqrt(rows[6])[texel]
    across = ((number % side + 0.5) / side - 0.5) * width
    along = ((number // side + 0.5) / side - 0.5) * width
    axis = rows[:3].T[texel]
    first, second = tangents(axis)
    direction = axis + first * across[:, None] + second * along[:, None]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    count, nothing = side.astype(np.float64) ** 2, np.zeros(len(texel))
    columns = direction.T, rows[3:6, texel] / count, rows[6, texel] / count, nothing, nothing
    return Clusters(*(np.ascontiguousarray(column, dtype=np.float32) for column in columns))


def tangents(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors [N, 3] across each unit axis [N, 3]: along the horizon, then up; at the poles along X and Y."""
    x, y, z = axis.T
    around = np.hypot(x, y)
    pole = around < 1e-9
    safe = np.where(pole, 1, around)
    first = np.stack([np.where(pole, 1, -y / safe), np.where(pole, 0, x / safe), 0 * z], axis=-1)
    return first, np.cross(axis, first)
