"""Pixels of the set beside the subject, where its shadow has details of a few pixels, and at its edge.

Source: docs/method.md section 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.proxy import ProxyScene
from yesnt.scene.mesh_edges import EdgeMix
from yesnt.scene.set_scene import SetView

F32 = NDArray[np.float32]

CONTACT = 4.0
"""Pixels from the subject within which every pixel is evaluated: toes and their gaps are a pixel or two wide."""


EDGE = 2
"""Pixels inside the subject's edge in which its coverage may still be below 1."""

_COVERED = 0.05  # coverage from which the subject divides a pixel


def subject_edge(view: SetView, opacity: F32, mesh: ProxyScene) -> EdgeMix:
    """Pixels of the set that the subject divides where it touches it, and the free ones around whose light they show.

    Of such a pixel the part beside the subject is seen, while its middle may lie in the dark under a foot: single such
    pixels would stand out as specks.

    Args:
        view: P pixels of the set.
        opacity: [H, W] coverage of the subject.
        mesh: the subject's.
    """
    pixels = view.pixels
    (height, width), reach = pixels.shape, np.arange(-EDGE, EDGE + 1)
    row, column = np.divmod(pixels.index, width)
    number = np.full((height + 2 * EDGE, width + 2 * EDGE), -1, np.intp)
    number[row + EDGE, column + EDGE] = np.arange(len(row))
    divided = opacity.reshape(-1)[pixels.index] > _COVERED
    inside = np.flatnonzero(divided)
    inside = inside[near_mesh(view, inside, mesh)]
    down, across = (a.reshape(-1) for a in np.meshgrid(reach, reach, indexing="ij"))
    around = number[row[inside, None] + EDGE + down, column[inside, None] + EDGE + across]
    free = (around >= 0) & ~divided[around]
    found = free.any(axis=1)
    weight = free[found] / free[found].sum(axis=1, keepdims=True)
    return EdgeMix(inside[found], around[found], weight.astype(np.float32))


def beside_subject(view: SetView, mesh: ProxyScene) -> NDArray[np.bool_]:
    """Pixels [P] of the set whose points lie within `CONTACT` pixels of a subject's mesh."""
    return near_mesh(view, np.arange(len(view.pixels.index)), mesh)


def near_mesh(view: SetView, which: NDArray[np.intp], mesh: ProxyScene) -> NDArray[np.bool_]:
    """Whether the points of pixels [n] lie within `CONTACT` pixels of a mesh."""
    from scipy.spatial import cKDTree

    position = view.pixels.position[which]
    reach = CONTACT * view.parts.spacing(which) * np.linalg.norm(position - view.parts.eye, axis=1)
    corners = mesh.vertices[mesh.faces]
    reach += np.median(np.linalg.norm(corners - mesh.centres[:, None], axis=2))  # points of the mesh lie so far apart
    farthest = float(reach.max(initial=0))
    low, high = mesh.bounds - farthest, mesh.bounds + farthest
    near = np.flatnonzero(((position > low[0]) & (position < high[1])).all(axis=1))
    found = np.zeros(len(which), np.bool_)
    if len(near):
        points = cKDTree(np.concatenate([mesh.vertices, mesh.centres]))
        apart, _ = points.query(position[near], distance_upper_bound=float(reach[near].max()))
        found[near] = apart < reach[near]
    return found
