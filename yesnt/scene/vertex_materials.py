"""Gives the vertices of the proxy what the delivered camera's pixels say of them (docs/method.md section 6)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera

F32 = NDArray[np.float32]

COVERED = 0.9
"""Coverage from which a pixel's materials are the subject's own: an edge pixel mixes them with what is behind it."""

NEAR = 0.03
"""Metres along the view within which a vertex lies on the surface that a pixel shows."""


class MeasuredVertices(NamedTuple):
    """What other cameras say of V vertices.

    Attributes:
        values: [V, K].
        known: [V] where they say anything.
    """

    values: F32
    known: NDArray[np.bool_]


def vertex_values(
    mesh: tuple[F32, NDArray[np.int32]],
    view: tuple[Camera, int | None],
    values: F32,
    opacity: F32,
    z: F32,
    measured: MeasuredVertices | None = None,
) -> F32:
    """Values of the vertices: of the pixel that shows a vertex, else as measured, else spread over the mesh from those.

    Args:
        mesh: vertices [V, 3] in world metres and triangles [F, 3].
        view: the camera and its frame; None: its first.
        values: [H, W, K] straight.
        opacity: [H, W] coverage; pixels of at least `COVERED` are read, where there are none all above 0.5.
        z: [H, W] planar metres.
        measured: by other cameras; None: there are none.

    Returns:
        [V, K]; the mean of the covered pixels for parts of the mesh of which no vertex is seen, 0 without any.
    """
    vertices, faces = mesh
    solid = covered_pixels(opacity)
    fallback = values[solid].mean(axis=0) if solid.any() else np.zeros(values.shape[-1])
    pixel, seen = _shown(vertices, view, solid, z)
    known = np.where(seen[:, None], values.reshape(-1, values.shape[-1])[pixel], 0).astype(np.float64)
    if measured is not None:
        known, seen = np.where(seen[:, None], known, measured.values), seen | measured.known
    return _spread(known, seen, faces, fallback).astype(np.float32)


def shown_vertices(vertices: F32, view: tuple[Camera, int | None], opacity: F32, z: F32) -> NDArray[np.bool_]:
    """Whether the picture shows each vertex [V]; arguments as of `vertex_values`."""
    return _shown(vertices, view, covered_pixels(opacity), z)[1]


def covered_pixels(opacity: F32) -> NDArray[np.bool_]:
    """Pixels [H, W] whose materials are the subject's own; those of more than half coverage where there are none."""
    whole = opacity >= COVERED
    return whole if whole.any() else opacity > 0.5


def _shown(
    vertices: F32, view: tuple[Camera, int | None], solid: NDArray[np.bool_], z: F32
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """The flat index of the pixel in which each vertex lies [V], and whether the pixel shows it."""
    height, width = solid.shape
    place = view[0].project(vertices, view[1])
    front = np.isfinite(place).all(axis=1) & (place[:, 2] > 0)
    column, row = (np.floor(np.where(front, place[:, k], -1)).astype(np.int64) for k in (0, 1))
    inside = front & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixel = np.where(inside, row * width + column, 0)
    near = np.abs(z.reshape(-1)[pixel] - place[:, 2]) < NEAR
    return pixel, inside & near & solid.reshape(-1)[pixel]


def _spread(
    known: NDArray[np.float64], seen: NDArray[np.bool_], faces: NDArray[np.int32], fallback: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Fills ring after ring: a vertex takes the mean of its neighbours that have a value."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    out, have = known.copy(), seen.copy()
    while not have.all():
        edges = ends[~have[ends[:, 0]] & have[ends[:, 1]]]
        if not len(edges):
            break
        number = np.bincount(edges[:, 0], minlength=len(have))
        total = [np.bincount(edges[:, 0], out[edges[:, 1], k], len(have)) for k in range(out.shape[1])]
        reached = number > 0
        out[reached] = (np.stack(total, axis=-1) / np.maximum(number, 1)[:, None])[reached]
        have |= reached
    out[~have] = fallback
    return out
