"""What stands between a pixel and each light cluster: the proxy, else the depth buffer, else nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.indirect import Glow
from yesnt.relight.lights import Clusters, PreparedLight
from yesnt.relight.march import DepthScene, depth_scene, march
from yesnt.relight.points import Pixels, Surface
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.sparse import Band, sparse_hits

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

SHARP = 0.3
"""Roughness below which a lobe, 2 r^2 wide, is narrower than a light cluster, and sees single occluders."""

_MAIN = 8  # brightest clusters that stand for "the light" in the single factor


@dataclass(frozen=True)
class Occluders:
    """Whatever a frame has to cast shadows with, and the origins of shadow rays.

    Attributes:
        origins: [P, 3] world; the pixels' positions, moved off the surface.
        proxy: the mesh, or None.
        depth: the depth buffer, or None.
        shown: [P] triangle of the proxy behind each pixel, -1 where none; empty without a proxy.
        footprint: [P] metres that a pixel covers at its depth; empty without a proxy.
    """

    origins: F32
    proxy: ProxyScene | None
    depth: DepthScene | None
    shown: NDArray[np.int32]
    footprint: F32


def find_occluders(surface: Surface, pixels: Pixels, proxy: ProxyScene | None, settings: RelightSettings) -> Occluders:
    """Chooses the occluder that `settings.shadows` and the shot allow."""
    nothing = np.zeros(0, dtype=np.int32)
    if settings.shadows is False or len(pixels.index) == 0:
        return Occluders(pixels.position, None, None, nothing, pixels.position[:0, 0])
    if settings.shadows == "single" or proxy is None:
        depth = depth_scene(surface, pixels, settings.thickness)
        return Occluders(pixels.position, None, depth, nothing, pixels.position[:0, 0])
    eye = surface.camera.position(surface.frame).astype(np.float32)
    shown, gap = _seen_triangle(proxy, eye, pixels)
    origins = pixels.position + pixels.view * gap[:, None] + pixels.normal * np.float32(settings.offset)
    footprint = np.linalg.norm(pixels.position - eye, axis=1) / np.float32(surface.camera.fx)
    return Occluders(origins.astype(np.float32), proxy, None, shown, footprint.astype(np.float32))


def _seen_triangle(proxy: ProxyScene, eye: F32, pixels: Pixels) -> tuple[NDArray[np.int32], F32]:
    """Triangle behind each pixel and how far, metres, the pixel's point lies below it along the view (at least 0).

    A point below the decimated surface would be shadowed by its own triangle, so rays start where the eye meets the
    proxy. Deeper than 3 cm it is another surface in front, which does shadow it.
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
    glow: Glow | None,
    settings: RelightSettings,
) -> tuple[NDArray[np.bool_] | None, F32 | None]:
    """Hidden clusters [P, C] and bounced radiance [3, P, C] of a range of pixels, None where there is nothing to say.

    Args:
        occluders: of the frame.
        pixels: of the frame.
        band: range of pixels.
        light: whose clusters are asked for.
        glow: what the proxy's triangles send out, None for black ones.
        settings: of the stage.
    """
    part = band.part
    origins, normals = occluders.origins[part], pixels.normal[part]
    if occluders.proxy is not None:
        if settings.rays == "sparse":
            footprint = occluders.footprint
            hits = sparse_hits(occluders.proxy, occluders.origins, pixels, band, light.clusters, footprint)
        else:
            hits = occluders.proxy.cluster_hits(origins, normals, light.clusters)
        mirror = _mirror_rays(occluders.proxy, origins, pixels, part, light.clusters, hits)
        bounced = None if glow is None else glow.towards(hits, light.clusters.direction, *mirror)
        return hits != OPEN, bounced
    if occluders.depth is None or settings.shadows == "single":
        return None, None
    return march(occluders.depth, origins, normals, light.clusters.direction, settings.march_steps), None


def _mirror_rays(
    proxy: ProxyScene, origins: F32, pixels: Pixels, part: slice, clusters: Clusters, hits: I32
) -> tuple[F32, I32]:
    """Lets sharp pixels see along their mirrored view what is there, instead of at the middle of a cluster.

    Writes what that ray hits into `hits` [P, C], for the cluster that it points to; returns the rays' directions [P, 3]
    and these clusters [P], -1 for pixels that are not sharp.
    """
    normal, view = pixels.normal[part], pixels.view[part]
    own = np.full(len(normal), -1, dtype=np.int32)
    along = (2 * (normal * view).sum(axis=1, keepdims=True) * normal - view).astype(np.float32)
    sharp = np.flatnonzero((pixels.roughness[part] < SHARP) & ((along * normal).sum(axis=1) > 0))
    if len(sharp):
        own[sharp] = clusters.nearest(along[sharp])
        hits[sharp, own[sharp]] = proxy.first_hits(origins[sharp], along[sharp])
    return along, own


def single_factor(
    occluders: Occluders, pixels: Pixels, part: slice, light: PreparedLight, settings: RelightSettings
) -> F32:
    """The paper's one soft factor [P, 1]: how much of the brightest light a march towards it lets through."""
    clusters = light.clusters
    power = clusters.energy.sum(axis=0)
    if occluders.depth is None or not power.any():
        return np.ones((part.stop - part.start, 1), np.float32)
    main = np.argsort(-power, kind="stable")[:_MAIN]
    origins, normals = occluders.origins[part], pixels.normal[part]
    hidden = march(occluders.depth, origins, normals, clusters.direction[:, main], settings.march_steps)
    share = power[main] / max(float(power[main].sum()), 1e-30)
    return ((1 - hidden.astype(np.float32)) @ share[:, None]).astype(np.float32)
