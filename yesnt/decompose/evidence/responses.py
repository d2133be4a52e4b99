"""Responses of the capture light for every point, camera and roughness, by the lobe sums of relighting.

The same kernels, visibility and energy terms as relighting (docs/method.md section 5), so that what the evidence
explains is what relighting will divide out. A direction that the proxy occludes shows the mean plate radiance of the
triangle that it hits: the capture has seen it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.observe import Sample
from yesnt.decompose.evidence.records import Responses
from yesnt.relight.albedo import energy_terms
from yesnt.relight.brdf import F0_DIELECTRIC, alpha_ggx
from yesnt.relight.combine import normalise
from yesnt.relight.frame import lobe_engine
from yesnt.relight.kernels import DIELECTRIC, IRRADIANCE, METAL_F0, METAL_F90
from yesnt.relight.level_records import LevelPoints, LevelSums, LevelTerms
from yesnt.relight.level_sums import sum_levels
from yesnt.relight.lights import PreparedLight
from yesnt.relight.occlusion import SHARP, Occluders, mirrored_hits, trace_mirrored
from yesnt.relight.points import Pixels, widened
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.sparse import Band, sparse_hits

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_BOTH = 0.5  # a metallic for which the kernels sum both lobes


@dataclass(frozen=True)
class CaptureScene:
    """What lights the points of a frame.

    Attributes:
        light: the capture light, with C clusters.
        occluders: the proxy and the origins of shadow rays of all pixels.
        shown: [F + 1, 3] radiance that each triangle of the proxy sends, as the cameras saw it; the last row is 0.
        settings: of relighting.
    """

    light: PreparedLight
    occluders: Occluders
    shown: F32
    settings: RelightSettings

    @property
    def proxy(self) -> ProxyScene:
        """The proxy mesh."""
        assert self.occluders.proxy is not None
        return self.occluders.proxy


@dataclass(frozen=True)
class LitPoints:
    """P points and the triangles that occlude the capture light there.

    Attributes:
        pixels: the points.
        origins: [P, 3] of their shadow rays, world metres.
        hits: [P, C] triangle towards each light cluster, OPEN where there is none.
        footprint: [P] metres that a pixel of the plate covers at the point.
    """

    pixels: Pixels
    origins: F32
    hits: I32
    footprint: F32

    def taken(self, which: NDArray[np.intp]) -> LitPoints:
        """Some of the points."""
        return LitPoints(self.pixels.taken(which), self.origins[which], self.hits[which], self.footprint[which])


def lit_points(pixels: Pixels, scene: CaptureScene, band: Band) -> LitPoints:
    """Traces what occludes the capture light of a band of the frame's pixels."""
    occluders, part = scene.occluders, band.part
    normals, clusters = pixels.normal[part], scene.light.clusters
    if scene.settings.rays == "sparse":
        hits = sparse_hits(scene.proxy, occluders.origins, pixels, band, clusters, occluders.footprint)
    else:
        hits = scene.proxy.cluster_hits(occluders.origins[part], normals, clusters)
    return LitPoints(pixels.taken(part), occluders.origins[part], hits, occluders.footprint[part])


def probe_points(pixels: Pixels, few: NDArray[np.intp], scene: CaptureScene) -> LitPoints:
    """The same of single pixels of the frame, each traced by itself."""
    occluders, chosen = scene.occluders, pixels.taken(few)
    hits = scene.proxy.cluster_hits(occluders.origins[few], chosen.normal, scene.light.clusters)
    return LitPoints(chosen, occluders.origins[few], hits, occluders.footprint[few])


def responses(points: LitPoints, samples: list[Sample], scene: CaptureScene, levels: NDArray[np.floating]) -> Responses:
    """Responses of P points towards V cameras for R levels of roughness, ascending; 0 where a camera sees no point."""
    shape = len(points.hits), len(samples), len(levels)
    diffuse, dielectric, f0, f90 = (np.zeros((*shape, 3), dtype=np.float32) for _ in range(4))
    missing = np.zeros(shape, dtype=np.float32)
    average, terms = np.ones(len(levels), dtype=np.float32), None
    if shares_levels(scene.settings):
        terms = LevelTerms.of(levels)
        average[:] = terms.average
    for v, sample in enumerate(samples):
        seen = np.flatnonzero(sample.valid)
        if not len(seen):
            continue
        few = points.taken(seen)
        light = _ViewedLight(few, sample.towards[seen], sample.footprint[seen], scene)
        if terms is not None:
            sums = light.at_levels(levels, terms)
            diffuse[seen, v], dielectric[seen, v], f0[seen, v], f90[seen, v], missing[seen, v] = sums
            continue
        for r, level in enumerate(levels):
            found = light.response(float(level))
            diffuse[seen, v, r], dielectric[seen, v, r], f0[seen, v, r], f90[seen, v, r] = found.lobes
            missing[seen, v, r], average[r] = found.missing, found.average
    return Responses(diffuse, dielectric, f0, f90, missing, average)


def shares_levels(settings: RelightSettings) -> bool:
    """Whether relight/level_sums.py sums all levels at once: the defaults, on the processor."""
    return (settings.engine, settings.brdf, settings.diffuse) == ("numba", "default", "lambert")


def turned_responses(
    points: LitPoints, samples: list[Sample], scene: CaptureScene, levels: NDArray[np.floating], degrees: float
) -> tuple[Responses, Responses]:
    """The same for normals turned by so many degrees, about one tangent and about the other."""
    first, second = tangents(points.pixels.normal)
    return _turned(points, first, samples, scene, levels, degrees), _turned(
        points, second, samples, scene, levels, degrees
    )


def _turned(
    points: LitPoints,
    tangent: F32,
    samples: list[Sample],
    scene: CaptureScene,
    levels: NDArray[np.floating],
    degrees: float,
) -> Responses:
    angle = np.radians(degrees)
    normal = np.cos(angle) * points.pixels.normal + np.sin(angle) * tangent
    return responses(
        replace(points, pixels=replace(points.pixels, normal=normal.astype(np.float32))), samples, scene, levels
    )


def tangents(normal: F32) -> tuple[F32, F32]:
    """Two unit vectors [P, 3] at right angles to unit normals [P, 3] and to each other."""
    axis = np.eye(3, dtype=np.float32)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first.astype(np.float32), np.cross(normal, first).astype(np.float32)


@dataclass(frozen=True)
class _Found:
    """Responses of N points towards one camera at one roughness.

    Attributes:
        lobes: diffuse, dielectric, metal_f0, metal_f90, each [N, 3].
        missing: [N].
        average: of the lobe.
    """

    lobes: tuple[F32, F32, F32, F32]
    missing: F32
    average: float


class _ViewedLight:
    """Light that reaches one camera from N points."""

    def __init__(self, points: LitPoints, towards: F32, footprint: F32, scene: CaptureScene) -> None:
        p, self._scene = points.pixels, scene
        wider = (footprint / np.maximum(points.footprint, 1e-12)) ** 2
        turn = None if p.turn is None else np.minimum(p.turn * wider, 1).astype(np.float32)
        metallic = np.full(len(towards), _BOTH, np.float32)
        self._pixels = replace(p, view=towards, metallic=metallic, turn=turn)
        self._points = points
        self._broad: tuple[NDArray[np.bool_], F32] | None = None
        self._sharp: tuple[NDArray[np.bool_], F32] | None = None

    def _occlusion(self, hits: I32) -> tuple[NDArray[np.bool_], F32]:
        """Occluded clusters [N, C] and the radiance [3, N, C] that comes from there."""
        indirect = np.stack([self._scene.shown[hits, k] for k in range(3)])
        return hits != OPEN, indirect

    def _occlusion_at(self, pixels: Pixels) -> tuple[NDArray[np.bool_], F32]:
        """The same at a roughness: sharp lobes trace a ray along the mirrored view."""
        if pixels.roughness[0] >= SHARP:
            if self._broad is None:
                self._broad = self._occlusion(self._points.hits)
            return self._broad
        if self._sharp is None:
            hits = self._points.hits.copy()
            whole = slice(0, len(hits))
            clusters = self._scene.light.clusters
            trace_mirrored(self._scene.proxy, self._points.origins, pixels, whole, clusters, hits)
            self._sharp = self._occlusion(hits)
        return self._sharp

    def at_levels(self, levels: NDArray[np.floating], terms: LevelTerms) -> LevelSums:
        """Responses at all levels of roughness, ascending."""
        p, scene, rough = self._pixels, self._scene, np.asarray(levels, np.float32)
        alpha = np.repeat(alpha_ggx(rough)[None], len(p.index), axis=0)
        if p.turn is not None:
            alpha = widened(alpha, p.turn[:, None])
        own = found = np.full(len(p.index), OPEN, np.int32)
        if rough[0] < SHARP:
            sharpest, whole = np.full(len(p.index), rough[0], np.float32), slice(0, len(p.index))
            pixels = replace(p, roughness=sharpest)
            own, _, found = mirrored_hits(scene.proxy, self._points.origins, pixels, whole, scene.light.clusters)
        sharp = int(np.count_nonzero(rough < SHARP))
        seen = LevelPoints(p.normal, p.view, alpha, self._points.hits, own, found, sharp)
        return sum_levels(seen, scene.light, scene.shown, terms)

    def response(self, level: float) -> _Found:
        """Responses at one roughness."""
        p, settings = self._pixels, self._scene.settings
        roughness = np.full(len(p.index), level, np.float32)
        pixels = replace(p, roughness=roughness)
        whole, plain = slice(0, len(roughness)), settings.brdf == "paper"
        lobes = pixels.lobes(whole, settings.brdf, settings.diffuse)
        sums = lobe_engine(settings)(lobes, self._scene.light, *self._occlusion_at(pixels), not plain)
        return _paper(sums) if plain else _layered(normalise(sums, pixels, whole, settings.diffuse), pixels)


def _paper(sums: F32) -> _Found:
    """`brdf="paper"`: one lobe with F0 = 0.04 (1 - m) + b m."""
    f0, f90 = sums[:, METAL_F0], sums[:, METAL_F90]
    lobes = sums[:, IRRADIANCE] / np.float32(np.pi), F0_DIELECTRIC * f0 + f90, f0, f90
    return _Found(lobes, np.zeros(len(sums), np.float32), 1.0)


def _layered(sums: F32, pixels: Pixels) -> _Found:
    """`brdf="default"`: a diffuse under a dielectric layer, and a metal, each compensated for multiple scattering."""
    terms = energy_terms(pixels.roughness, pixels.cos_o)
    layer, factor = (a[:, None].astype(np.float32) for a in (terms.layer, terms.dielectric))
    lobes = (
        layer * sums[:, IRRADIANCE] / np.float32(np.pi), factor * sums[:, DIELECTRIC],
        sums[:, METAL_F0], sums[:, METAL_F90],
    )  # fmt: skip
    return _Found(lobes, terms.missing.astype(np.float32), float(terms.average[0]))
