"""Where z of the delivered view and the proxy contradict each other, the proxy tells where a point lies.

What a camera sees of a point is decided by the proxy. A point beside it would be looked up in the wrong pixels of all
other cameras: 3 cm at 3 m are 4 pixels of a picture of 256, and nothing in the pictures says so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight.points import Surface, has_depth
from yesnt.relight.proxy import OPEN, ProxyScene

F32 = NDArray[np.float32]

SLOPE = 1.5
"""Pixels by which an observation may be off: on a slanted surface the depth differs by that."""

LEAST_COSINE = 0.15
"""In the slope's denominator: a grazing surface has no bound."""

_SHARE = 0.5  # of what a camera's point may be off by: half is left to its own picture
_FARTHEST = 0.1  # of the proxy's size, beyond which the ray has hit another part of the subject


def planar_depth(proxy: ProxyScene, eye: NDArray[np.floating], rays: F32) -> F32:
    """Planar depth [N] of the proxy along rays [N, 3] of camera z = 1 from `eye` [3]; 0 where it is missed."""
    length = np.linalg.norm(rays, axis=1)
    origin = np.broadcast_to(eye.astype(np.float32), rays.shape)
    hit = proxy.trace(origin, (rays / length[:, None]).astype(np.float32))
    return np.where(hit["primID"] == OPEN, 0, hit["tfar"] / length).astype(np.float32)


def slope(cosine: NDArray[np.floating]) -> NDArray[np.floating]:
    """Change of depth over a way across the picture, from the cosine between normal and view."""
    return np.asarray(np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, LEAST_COSINE))


def on_proxy(
    surface: Surface, proxy: ProxyScene, size: float, settings: EvidenceSettings
) -> tuple[Surface, NDArray[np.bool_]]:
    """The surface with z of the proxy where both differ by more than half of `settings.depth`; which pixels [H, W].

    Args:
        surface: of the delivered view.
        proxy: of the subject.
        size: its largest extent, metres.
        settings: of the evidence.
    """
    known = has_depth(surface.z) & (np.nan_to_num(surface.opacity) > 0)
    moved, z = np.zeros(known.shape, np.bool_), np.asarray(surface.z, np.float32).copy()
    rays = surface.camera.rays(surface.frame)[known]
    if not len(rays):
        return surface, moved
    depth = planar_depth(proxy, surface.camera.position(surface.frame), rays)
    cosine = -(np.nan_to_num(surface.normal[known]) * rays).sum(axis=1) / np.linalg.norm(rays, axis=1)
    apart = np.abs(depth - z[known])
    allowed = _SHARE * settings.depth * size / np.maximum(cosine, LEAST_COSINE)  # a way along the normal, seen aslant
    moved[known] = (depth > 0) & (apart > allowed) & (apart < _FARTHEST * size)
    z[moved] = depth[moved[known]]
    return replace(surface, z=z), moved
