"""The proxy mesh of a Gaussian opacity field: a level set on a tetrahedralisation of its Gaussians (docs/method.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.mesh_settings import MeshSettings
from yesnt.gaussians.opacity import Ellipsoids, ellipsoids, opacity_at
from yesnt.gaussians.tetrahedra import Crossing, march

F64 = NDArray[np.float64]
Cameras = Sequence[tuple[Camera, int | None]]
"""Cameras that looked at the subject, with the frame whose pose they have; None: their only one."""


@dataclass(frozen=True)
class ProxyMesh:
    """Triangles: vertices [V, 3] float32 metres in the world, faces [F, 3] int32, counter-clockwise from outside."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def extract_mesh(field: GaussianField, cameras: Cameras, settings: MeshSettings | None = None) -> ProxyMesh:
    """The surface of a field, closed and decimated; without triangles where the field is empty.

    Args:
        field: the Gaussians.
        cameras: those that the field was fitted to: space that none of them sees counts as inside.
        settings: of the extraction.
    """
    settings = settings or MeshSettings()
    vertices, faces = level_set(field, cameras, settings)
    vertices, faces = largest_parts(vertices, faces, settings.least_part)
    return simplify(vertices, faces, settings)


def level_set(field: GaussianField, cameras: Cameras, settings: MeshSettings) -> tuple[F64, NDArray[np.int64]]:
    """Vertices and faces of the surface where the opacity is `level`, as fine as the Gaussians are."""
    from scipy.spatial import Delaunay

    shapes = ellipsoids(field)
    points = _points(shapes, settings)
    if len(points) < 5:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    opacity = opacity_at(points, shapes, cameras, settings.level)
    around = _around(points)
    points, opacity = np.concatenate([points, around]), np.concatenate([opacity, np.zeros(len(around))])
    inside = opacity >= settings.level
    crossing = march(points, Delaunay(points).simplices, inside)
    return bisect(points, crossing, shapes, cameras, settings), crossing.faces


def _points(shapes: Ellipsoids, settings: MeshSettings) -> F64:
    """Corners and centres [P, 3] of the Gaussians' boxes, each once."""
    chosen = shapes.opacities >= settings.least_opacity
    axes = np.linalg.inv(shapes.whitening[chosen])  # columns: own axes, one standard deviation long
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)] + [[0, 0, 0]], np.float64)
    corners = shapes.centres[chosen][:, None] + settings.box * np.einsum("nij,kj->nki", axes, signs)
    return np.unique(corners.reshape(-1, 3), axis=0)


def _around(points: F64) -> F64:
    """Corners [8, 3] of a box well outside all points: empty space, so that every surface is closed."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), max(float((high - low).max()), 1e-6)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    return np.asarray(middle + half * signs)


def bisect(points: F64, crossing: Crossing, shapes: Ellipsoids, cameras: Cameras, settings: MeshSettings) -> F64:
    """Vertices [V, 3] moved along their edges to the level, by halving `bisections` times."""
    inside, outside = points[crossing.inside].copy(), points[crossing.outside].copy()
    for _ in range(settings.bisections):
        middle = 0.5 * (inside + outside)
        above = opacity_at(middle, shapes, cameras, settings.level) >= settings.level
        inside[above], outside[~above] = middle[above], middle[~above]
    return np.asarray(0.5 * (inside + outside))


def largest_parts(vertices: F64, faces: NDArray[np.int64], least: float) -> tuple[F64, NDArray[np.int64]]:
    """Components whose area is at least a share of the largest one's, without unused vertices."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return vertices, faces
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]).T
    links = coo_matrix((np.ones(ends.shape[1], np.bool_), (ends[0], ends[1])), (len(vertices), len(vertices)))
    _, part = connected_components(links, directed=False)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.bincount(part[faces[:, 0]], np.linalg.norm(np.cross(b - a, c - a), axis=1))
    kept = faces[(area >= least * area.max())[part[faces[:, 0]]]]
    used, index = np.unique(kept, return_inverse=True)
    return vertices[used], index.reshape(-1, 3)


def simplify(vertices: F64, faces: NDArray[np.int64], settings: MeshSettings) -> ProxyMesh:
    """Smooths and decimates by quadric errors to at most `triangles`."""
    import fast_simplification

    if settings.smoothing and len(faces):
        vertices = smooth(vertices, faces, settings.smoothing)
    if len(faces) > settings.triangles:
        vertices, faces = fast_simplification.simplify(
            np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32),
            target_count=settings.triangles,
        )  # fmt: skip
    return ProxyMesh(np.asarray(vertices, np.float32), np.asarray(faces, np.int32))


def smooth(vertices: F64, faces: NDArray[np.int64], passes: int) -> F64:
    """Taubin's smoothing: each pass a step to the neighbours' mean, and a slightly longer step back."""
    from scipy.sparse import coo_matrix, diags

    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0).T
    count = len(vertices)
    links = coo_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), (count, count)).tocsr()
    mean = diags(1 / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)) @ links
    for _ in range(passes):
        for step in (0.5, -0.53):
            vertices = vertices + step * (mean @ vertices - vertices)
    return vertices
