"""Visibility of each light cluster from each pixel: rays to the proxy mesh, else a march in the depth buffer.

Source: docs/method.md section 5 (visibility).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.indirect import IndirectLight, PixelRays
from yesnt.relight.lens import pixel_focal
from yesnt.relight.lights import Clusters, PreparedLight
from yesnt.relight.march import DepthScene, depth_scene, march
from yesnt.relight.points import Pixels, Surface
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.sparse import Band, sparse_hits
from yesnt.relight.surroundings import Surroundings

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

SHARP = 0.3
"""Roughness r below which a specular lobe, 2 r^2 rad wide, is narrower than a light cluster: such a pixel traces a ray
of its own along the mirrored view."""

_MOST_LEAN = 4.0  # metres outwards for each metre up: a surface that leans more lies on the ground

_MAIN = 8  # brightest clusters, which the single factor is averaged over


@dataclass(frozen=True)
class Occluders:
    """What casts shadows in a frame, and the origins of shadow rays of its P pixels. At most one of both is there.

    Attributes:
        origins: [P, 3] world metres; the pixels' positions, moved off the surface.
        proxy: the proxy mesh, or None.
        depth: the depth buffer, or None.
        shown: [P] triangle of the proxy behind each pixel, -1 where none; empty without a proxy.
        footprint: [P] metres that a pixel covers at its depth; empty without a proxy.
        surroundings: the set, whose triangles are the last of the proxy; None: there is no set.
    """

    origins: F32
    proxy: ProxyScene | None
    depth: DepthScene | None
    shown: NDArray[np.int32]
    footprint: F32
    surroundings: Surroundings | None = None

    def within(self, surroundings: Surroundings | None, normal: F32, offset: float) -> Occluders:
        """The same with a set around the subject; without a proxy there is none.

        Args:
            surroundings: the set, or None.
            normal: [P, 3] unit, world, of the pixels.
            offset: distance of the rays' origins from a ground plane, metres, at least.
        """
        if surroundings is None or self.proxy is None:
            return self
        origins = self.origins
        if surroundings.floor is not None:
            origins = lifted(origins, normal, np.float32(surroundings.floor + offset))
        return replace(self, origins=origins, proxy=surroundings.around(self.proxy), surroundings=surroundings)


def lifted(origins: F32, normal: F32, least: np.float32) -> F32:
    """Origins [P, 3] at a height of at least `least`, which stay on their side of a surface that leans over them.

    Straight up, the origin of a point at the foot of an overhang would enter the subject, and all would be dark there.
    It is moved outwards by as much as the surface leans, at most by four times its lift.
    """
    lift = np.maximum(least - origins[:, 2], 0)
    level = np.maximum(np.hypot(normal[:, 0], normal[:, 1]), np.float32(1e-6))
    lean = np.clip(-normal[:, 2] / level, 0, _MOST_LEAN)
    out = origins + normal * np.array([1, 1, 0], np.float32) * (lift * lean / level)[:, None]
    return np.concatenate([out[:, :2], (origins[:, 2] + lift)[:, None]], axis=1).astype(np.float32)


def find_occluders(surface: Surface, pixels: Pixels, proxy: ProxyScene | None, settings: RelightSettings) -> Occluders:
    """Chooses what casts shadows.

    Args:
        surface: G-buffer of the frame; its z is the depth buffer.
        pixels: its covered pixels.
        proxy: the proxy mesh of the frame, or None.
        settings: `shadows` False: nothing; "single": the depth buffer; True: the proxy, else the depth buffer.
    """
    nothing = np.zeros(0, dtype=np.int32)
    if settings.shadows is False or len(pixels.index) == 0:
        return Occluders(pixels.position, None, None, nothing, pixels.position[:0, 0])
    if settings.shadows == "single" or proxy is None:
        depth = depth_scene(surface, pixels, settings.thickness)
        return Occluders(pixels.position, None, depth, nothing, pixels.position[:0, 0])
    eye = surface.camera.position(surface.frame).astype(np.float32)
    shown, gap = _seen_triangle(proxy, eye, pixels)
    origins = pixels.position + pixels.view * gap[:, None] + pixels.normal * np.float32(settings.offset)
    focal = np.float32(pixel_focal(surface.camera.lens(surface.frame)))
    footprint = np.linalg.norm(pixels.position - eye, axis=1) / focal
    return Occluders(origins.astype(np.float32), proxy, None, shown, footprint.astype(np.float32))


def _seen_triangle(proxy: ProxyScene, eye: F32, pixels: Pixels) -> tuple[NDArray[np.int32], F32]:
    """Triangle behind each pixel [P], and how far the pixel's point lies below it along the view [P], metres, >= 0.

    A point below the decimated surface would be shadowed by its own triangle, so its rays start where the view ray
    meets the proxy. If it lies deeper than 3 cm, the triangle is another surface in front of it and does shadow it.
    """
    along = -pixels.view
    shown = proxy.first_hits(np.broadcast_to(eye, along.shape).astype(np.float32), along)
    face = np.maximum(shown, 0)
    slope = (proxy.normals[face] * along).sum(axis=1)
    reach = ((proxy.centres[face] - eye) * proxy.normals[face]).sum(axis=1) / np.where(slope == 0, 1, slope)
    gap = np.linalg.norm(pixels.position - eye, axis=1) - reach
    good = (shown >= 0) & (slope != 0) & (gap > 0) & (gap < 0.03)
    return shown, np.where(good, gap, 0).astype(np.float32)


def occlusion(
    occluders: Occluders,
    pixels: Pixels,
    band: Band,
    light: PreparedLight,
    indirect: IndirectLight | None,
    settings: RelightSettings,
) -> tuple[NDArray[np.bool_] | None, F32 | None]:
    """Which light clusters are occluded for a range of pixels, and the indirect radiance from there.

    Args:
        occluders: of the frame.
        pixels: of the frame.
        band: range of P pixels.
        light: with C clusters.
        indirect: radiance of the proxy's triangles; None for black ones.
        settings: of the stage.

    Returns:
        Occluded clusters [P, C], None if nothing casts shadows per cluster; indirect radiance [3, P, C], None for 0.
    """
    part = band.part
    origins, normals = occluders.origins[part], pixels.normal[part]
    if occluders.proxy is not None:
        if settings.rays == "sparse":
            footprint = occluders.footprint
            hits = sparse_hits(occluders.proxy, occluders.origins, pixels, band, light.clusters, footprint)
        else:
            hits = occluders.proxy.cluster_hits(origins, normals, light.clusters)
        mirror, cluster = trace_mirrored(occluders.proxy, origins, pixels, part, light.clusters, hits)
        if indirect is None:
            return hits != OPEN, None
        return hits != OPEN, indirect.towards(PixelRays(hits, light.clusters.direction, mirror, cluster))
    if occluders.depth is None or settings.shadows == "single":
        return None, None
    return march(occluders.depth, origins, normals, light.clusters.direction, settings.march_steps), None


def trace_mirrored(
    proxy: ProxyScene, origins: F32, pixels: Pixels, part: slice, clusters: Clusters, hits: I32
) -> tuple[F32, I32]:
    """Replaces, for sharp pixels, the ray to the middle of one cluster by a ray along the mirrored view.

    Writes what that ray hits to `hits` [P, C], at the cluster that it points to. Returns the mirrored views [P, 3] and
    these clusters [P], -1 for pixels that are not sharp.
    """
    own, along, found = mirrored_hits(proxy, origins, pixels, part, clusters)
    sharp = np.flatnonzero(own >= 0)
    hits[sharp, own[sharp]] = found[sharp]
    return along, own


def mirrored_hits(
    proxy: ProxyScene, origins: F32, pixels: Pixels, part: slice, clusters: Clusters
) -> tuple[I32, F32, I32]:
    """The cluster [P] that the mirrored view of each sharp pixel points to, else -1, that view [P, 3], what it hits."""
    normal, view = pixels.normal[part], pixels.view[part]
    own, found = np.full(len(normal), -1, dtype=np.int32), np.full(len(normal), OPEN, dtype=np.int32)
    along = (2 * (normal * view).sum(axis=1, keepdims=True) * normal - view).astype(np.float32)
    sharp = np.flatnonzero((pixels.roughness[part] < SHARP) & ((along * normal).sum(axis=1) > 0))
    if len(sharp):
        own[sharp] = clusters.nearest(along[sharp])
        found[sharp] = proxy.first_hits(origins[sharp], along[sharp])
    return own, along, found


def single_factor(
    occluders: Occluders, pixels: Pixels, part: slice, light: PreparedLight, settings: RelightSettings
) -> F32:
    """The paper's single soft shadow factor of a range of pixels, [P, 1] in [0, 1].

    It is the share of the energy of the brightest clusters that a march in the depth buffer finds unoccluded; 1 without
    a depth buffer or light. Source: docs/method.md section 5.
    """
    clusters = light.undivided.clusters
    power = clusters.energy.sum(axis=0)
    if occluders.depth is None or not power.any():
        return np.ones((part.stop - part.start, 1), np.float32)
    main = np.argsort(-power, kind="stable")[:_MAIN]
    origins, normals = occluders.origins[part], pixels.normal[part]
    hidden = march(occluders.depth, origins, normals, clusters.direction[:, main], settings.march_steps)
    share = power[main] / max(float(power[main].sum()), 1e-30)
    return ((1 - hidden.astype(np.float32)) @ share[:, None]).astype(np.float32)
