"""Radiance that the triangles of the proxy send, as the cameras saw it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.observe import SeenView, sample_view
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight.proxy import ProxyScene

F32 = NDArray[np.float32]

_UNSEEN = 0.5
"""Share of the mean that a triangle sends which no camera sees: most of those lie in folds, where it is darker."""


def proxy_size(proxy: ProxyScene) -> float:
    """Largest extent of the proxy along an axis, metres."""
    return float(np.ptp(proxy.vertices, axis=0).max())


def shown_radiance(proxy: ProxyScene, views: list[SeenView], settings: EvidenceSettings) -> F32:
    """Mean radiance of each triangle over the cameras that see its centre, weighted by n.v; [F + 1, 3], the last 0."""
    size, count = proxy_size(proxy), len(proxy.faces)
    total, weight = np.zeros((count, 3)), np.zeros(count)
    for seen in views:
        found = sample_view(seen, proxy.centres, proxy.normals, size, settings)
        cosine = np.where(found.valid, (proxy.normals * found.towards).sum(axis=1), 0).astype(np.float64)
        total += found.radiance * cosine[:, None]
        weight += cosine
    mean = total.sum(axis=0) / max(weight.sum(), 1e-12)
    known = weight > 0
    sent = np.where(known[:, None], total / np.maximum(weight, 1e-12)[:, None], _UNSEEN * mean)
    return np.concatenate([sent, np.zeros((1, 3))]).astype(np.float32)
