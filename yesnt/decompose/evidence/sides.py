"""Base colour, roughness and metallic at points of the proxy that the delivered view does not show.

The same likelihood, prior and least squares as for the pixels of the delivered view (docs/method.md section 3b), at
vertices of the mesh, and pooled over its edges. Base colours are those of the cameras that see a point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.decompose.evidence.consistency import silhouette_contradiction
from yesnt.decompose.evidence.fit import negative_log_likelihood
from yesnt.decompose.evidence.observe import Sample, observations, prepare_view, sample_view, silhouette_overlap
from yesnt.decompose.evidence.posterior import log_prior, moments, posterior
from yesnt.decompose.evidence.records import Observations, View
from yesnt.decompose.evidence.reference import best_base_color
from yesnt.decompose.evidence.responses import CaptureScene, LitPoints, probe_points, responses
from yesnt.decompose.evidence.settings import EvidenceSettings, metallic_levels, roughness_levels
from yesnt.decompose.evidence.triangles import proxy_size, shown_radiance
from yesnt.relight.lights import PreparedLight
from yesnt.relight.occlusion import Occluders
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings

F32 = NDArray[np.float32]
Places = NDArray[np.intp]

_ROUNDS = 2
"""Times that costs are averaged with those of the vertices at the other ends of the edges."""


@dataclass(frozen=True)
class SurfacePoints:
    """N points of a mesh.

    Attributes:
        position: [N, 3] world metres.
        normal: [N, 3] unit, world.
        prior: [N, 2] roughness and metallic as far as they are known.
        edges: [E, 2] pairs of neighbouring points.
    """

    position: F32
    normal: F32
    prior: F32
    edges: NDArray[np.int64]


@dataclass(frozen=True)
class Cameras:
    """What was recorded.

    Attributes:
        views: pictures of the capture's cameras; those that contradict the proxy are left out.
        proxy: mesh of the subject.
        light: that they were taken under.
    """

    views: list[View]
    proxy: ProxyScene
    light: PreparedLight


def measure_points(
    points: SurfacePoints, cameras: Cameras, relight: RelightSettings, settings: EvidenceSettings
) -> tuple[F32, NDArray[np.bool_]]:
    """Base colour, roughness and metallic [N, 5], and which points [N] a camera sees; 0 at the others.

    Pure and deterministic. Where fewer than `least_views` cameras see a point its prior roughness and metallic stand.
    """
    values = np.zeros((len(points.position), 5), np.float32)
    measured = _Points(points, cameras, relight, settings)
    known = measured.known
    if known.any():
        values[:, 3:] = measured.materials()
        values[:, :3] = measured.base_color(values[:, 3], values[:, 4])
    return np.where(known[:, None], values, 0).astype(np.float32), known


class _Points:
    """The points and what the cameras saw of them."""

    def __init__(
        self, points: SurfacePoints, cameras: Cameras, relight: RelightSettings, settings: EvidenceSettings
    ) -> None:
        proxy, count = cameras.proxy, len(points.position)
        agree = [v for v in cameras.views if silhouette_contradiction(*silhouette_overlap(v, proxy)) is None]
        views = [prepare_view(view, proxy, settings) for view in agree]
        normal, whole = points.normal, np.ones(count, np.float32)
        self._points, self._settings = points, settings
        self._samples = [sample_view(v, points.position, normal, proxy_size(proxy), settings) for v in views]
        origins = (points.position + np.float32(relight.offset) * normal).astype(np.float32)
        occluders = Occluders(origins, proxy, None, np.zeros(count, np.int32), whole)
        shown = shown_radiance(proxy, views, settings)
        self._scene = CaptureScene(cameras.light, occluders, shown, replace(relight, shadows=True, rays="every"))
        roughness, metallic = points.prior.T
        self._pixels = Pixels(np.arange(count), (1, count), points.position, normal, normal, roughness, metallic)
        texels = cameras.light.texels
        energy = luminance(texels.energy.T.astype(np.float64)).sum()
        self._floor = settings.floor * max(float(energy / max(float(texels.solid_angle.sum()), 1e-12)), 1e-6)
        valid = np.array([one.valid for one in self._samples], np.bool_).reshape(-1, count)
        self._count = valid.sum(axis=0)
        self.known: NDArray[np.bool_] = self._count > 0

    def _observed(self, samples: list[Sample]) -> Observations:
        return observations(samples, self._floor, self._settings)

    def _lit(self, which: Places) -> tuple[LitPoints, list[Sample]]:
        return probe_points(self._pixels, which, self._scene), [one.taken(which) for one in self._samples]

    def materials(self) -> F32:
        """Roughness and metallic [N, 2]."""
        settings, prior = self._settings, self._points.prior
        cost = [
            negative_log_likelihood(
                self._observed(samples), responses(lit, samples, self._scene, roughness_levels(settings)), settings
            )
            for lit, samples in map(self._lit, _tiles(len(prior), settings.tile))
        ]
        pooled = _pooled(np.concatenate(cost), self._points.edges, self.known)
        found, _ = moments(posterior(pooled, log_prior(prior, 0 * prior, settings), settings), settings)
        enough = self._count >= settings.least_views
        return np.where(enough[:, None], found, prior).astype(np.float32)

    def base_color(self, roughness: F32, metallic: F32) -> F32:
        """Base colour [N, 3] by robust least squares over the cameras, at the nearest candidate."""
        settings, out = self._settings, np.zeros((len(roughness), 3), np.float32)
        rough, metal = roughness_levels(settings), metallic_levels(settings)
        nearest = [np.abs(a[:, None] - levels).argmin(axis=1) for a, levels in ((roughness, rough), (metallic, metal))]
        for number in np.unique(nearest[0] * len(metal) + nearest[1]):
            r, m = np.divmod(number, len(metal))
            at = np.flatnonzero((nearest[0] == r) & (nearest[1] == m) & self.known)
            for part in _tiles(len(at), settings.tile):
                lit, samples = self._lit(at[part])
                of = responses(lit, samples, self._scene, rough[r : r + 1])
                out[at[part]] = best_base_color(self._observed(samples), of, settings, 0, float(metal[m]))
        return out


def _tiles(count: int, size: int) -> list[Places]:
    return [np.arange(first, min(first + size, count)) for first in range(0, count, size)]


def _pooled(cost: F32, edges: NDArray[np.int64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Costs [N, R, M] averaged with those of neighbours that a camera sees; 0 where none is seen."""
    from scipy.sparse import coo_array

    count = len(cost)
    ends = np.concatenate([edges, edges[:, ::-1], np.repeat(np.arange(count)[:, None], 2, axis=1)])
    ends = ends[known[ends[:, 1]]]
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    number = np.maximum(np.asarray(graph.sum(axis=1)).reshape(-1, 1), 1)
    out = cost.reshape(count, -1).astype(np.float64)
    for _ in range(_ROUNDS):
        out = np.asarray(graph @ out) / number
    return out.reshape(cost.shape)
