"""Marching tetrahedra: the surface between the inside and the outside vertices of a tetrahedralisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
"""Edges of a tetrahedron by its vertices."""


@dataclass(frozen=True)
class Crossing:
    """A surface whose vertices lie somewhere on edges from an inside to an outside point.

    Attributes:
        inside: [V] index of each vertex's inside point.
        outside: [V] index of its outside point.
        faces: [F, 3] vertices, counter-clockwise seen from outside.
    """

    inside: I64
    outside: I64
    faces: I64


def march(points: F64, tetrahedra: NDArray[np.integer], inside: NDArray[np.bool_]) -> Crossing:
    """Triangulates the boundary between inside and outside points.

    Each tetrahedron with one corner on one side gives a triangle, with two on each side a quadrilateral that is cut in
    two. Tetrahedra that share a face cut its edges in the same vertices, so that the surface has no cracks.

    Args:
        points: [P, 3].
        tetrahedra: [T, 4] indices of points.
        inside: [P].
    """
    corners = np.asarray(tetrahedra, np.int64)
    count = inside[corners].sum(axis=1)
    pieces = [_triangles(corners[count == 1], inside, one_in=True), _triangles(corners[count == 3], inside, False)]
    pieces += _quadrilaterals(corners[count == 2], inside)
    ends = np.concatenate([ends for ends, _ in pieces])  # [F, 3, 2]: inside and outside point of each vertex
    apart = np.concatenate([apart for _, apart in pieces])  # [F, 2]: the tetrahedron's deepest and outermost corner
    edges, index = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    middle = 0.5 * (points[edges[:, 0]] + points[edges[:, 1]])
    a, b, c = middle[faces[:, 0]], middle[faces[:, 1]], middle[faces[:, 2]]
    outward = points[apart[:, 1]] - points[apart[:, 0]]
    turned = np.einsum("fi,fi->f", np.cross(b - a, c - a), outward) < 0
    faces[turned] = faces[turned][:, ::-1]
    return Crossing(edges[:, 0], edges[:, 1], faces)


def _triangles(corners: I64, inside: NDArray[np.bool_], one_in: bool) -> tuple[I64, I64]:
    """Triangles of tetrahedra with one corner apart from the other three."""
    alone = np.argmax(inside[corners] == one_in, axis=1)
    rows = np.arange(len(corners))
    others = np.stack([corners[rows, (alone + k) % 4] for k in (1, 2, 3)], axis=1)
    own = np.repeat(corners[rows, alone][:, None], 3, axis=1)
    ends = np.stack([own, others] if one_in else [others, own], axis=2)
    return ends, ends[:, 0]


def _quadrilaterals(corners: I64, inside: NDArray[np.bool_]) -> list[tuple[I64, I64]]:
    """Two triangles of each tetrahedron with two corners on each side."""
    order = np.argsort(~inside[corners], axis=1, kind="stable")  # inside corners first
    a, b, c, d = np.take_along_axis(corners, order, axis=1).T
    ac, bc, bd, ad = (np.stack(pair, axis=1) for pair in ((a, c), (b, c), (b, d), (a, d)))  # around the quadrilateral
    return [(np.stack(three, axis=1), ac) for three in ((ac, bc, bd), (ac, bd, ad))]
