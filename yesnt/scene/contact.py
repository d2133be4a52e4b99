"""Pixels of the set beside the subject, where its shadow has details of a few pixels.

Source: docs/method.md section 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.proxy import ProxyScene
from yesnt.scene.set_scene import SetView

CONTACT = 4.0
"""Pixels from the subject within which every pixel is evaluated: toes and their gaps are a pixel or two wide."""


def beside_subject(view: SetView, mesh: ProxyScene) -> NDArray[np.bool_]:
    """Pixels [P] of the set whose points lie within `CONTACT` pixels of a subject's mesh."""
    from scipy.spatial import cKDTree

    pixels, every = view.pixels, np.arange(len(view.pixels.index))
    reach = CONTACT * view.parts.spacing(every) * np.linalg.norm(pixels.position - view.parts.eye, axis=1)
    corners = mesh.vertices[mesh.faces]
    reach += np.median(np.linalg.norm(corners - mesh.centres[:, None], axis=2))  # points of the mesh lie so far apart
    low, high = mesh.bounds - reach.max(), mesh.bounds + reach.max()
    near = np.flatnonzero(((pixels.position > low[0]) & (pixels.position < high[1])).all(axis=1))
    points = cKDTree(np.concatenate([mesh.vertices, mesh.centres]))
    apart, _ = points.query(pixels.position[near], distance_upper_bound=float(reach[near].max(initial=1e-9)))
    found = np.zeros(len(every), np.bool_)
    found[near] = apart < reach[near]
    return found
