"""Strands of hair on a posed head, to measure the error of relighting that does not model hair."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

POINTS = 7
"""Points of a strand."""

_LENGTH = 0.085  # metres
_STIFF = 0.45  # how much of the way a strand follows its root's normal before it hangs


def grow(
    vertices: Array, faces: NDArray[np.int32], normals: Array, fields: Mapping[str, Array], count: int
) -> NDArray[np.float32]:
    """Points [count, POINTS, 3] in metres of strands that stand on the scalp, part and hang.

    Args:
        vertices: [V, 3] of the posed body.
        faces: [F, 4] quads.
        normals: [V, 3] unit, of the posed body.
        fields: places on the body (`costume.body_fields`): `head` and `scalp`.
        count: strands.
    """
    rng = np.random.Generator(np.random.Philox(key=[0, 11]))
    scalp = ((fields["head"] > 0.5) & (fields["scalp"] > 0.0))[faces].all(axis=1)
    quads = faces[scalp]
    chosen = quads[rng.choice(len(quads), count, p=_areas(vertices, quads))]
    u, v = rng.random((2, count, 1))
    shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=1)  # [count, 4, 1]
    root, away = ((values[chosen] * shares).sum(axis=1) for values in (vertices, normals))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return _hang(root, away + rng.normal(0, 0.15, away.shape), rng.uniform(0.7, 1.1, (count, 1)))


def _areas(vertices: Array, quads: NDArray[np.int32]) -> Array:
    """Share of the area [Q] that each quad has."""
    a, b, c, d = (vertices[quads[:, i]] for i in range(4))
    areas = np.linalg.norm(np.cross(c - a, d - b), axis=1)
    shares: Array = areas / areas.sum()
    return shares


def _hang(root: Array, away: Array, length: Array) -> NDArray[np.float32]:
    step, down = length * _LENGTH / (POINTS - 1), np.array([0.0, 0.0, -1.0])
    points, at = [root], root
    for i in range(1, POINTS):
        bend = min(1.0, i / (POINTS - 1) / _STIFF)
        direction = (1 - 0.65 * bend) * away + 0.8 * bend * down
        at = at + step * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        points.append(at)
    return np.stack(points, axis=1).astype(np.float32)
