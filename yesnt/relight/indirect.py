"""Indirect radiance: what the proxy mesh sends to a pixel from directions in which it occludes the light.

A triangle sends diffuse bounces (radiosity) and, where it is metal, what it mirrors. A metal has no diffuse colour, so
radiosity alone would show it black in another metal. To a pixel, a metal triangle shows the environment map filtered by
the triangle's own lobe along the mirrored direction. If the triangle is occluded in that direction, it shows its
occluder as a diffuse surface of the same colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.combine import normalise
from yesnt.relight.compiled import exact_entry, exact_inlined
from yesnt.relight.envmap import uv_to_direction
from yesnt.relight.kernels import METAL_F0, METAL_F90, sum_lobes
from yesnt.relight.lights import PreparedLight
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.ranges import over_ranges
from yesnt.relight.settings import RelightSettings
from yesnt.relight.surroundings import Surroundings

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

LEVELS = (0.1, 0.25, 0.4, 0.6, 1.0)
"""Roughness values for which the mirrored map is filtered, by the lobe at normal incidence."""

ROWS = 48
"""Rows of the filtered maps: 3.75 degrees, finer than a light cluster."""


_TINT = 1e-3  # sum of a triangle's metallic base colour below which it mirrors nothing


class MirroredLight(NamedTuple):
    """The environment map as metal triangles show it.

    Attributes:
        radiance: [L, ROWS, 2 ROWS, 3] lat-long maps filtered by the lobes of LEVELS, world axes; 0 at unused levels.
        cluster: [ROWS, 2 ROWS] the coarse light cluster that each direction belongs to.
    """

    radiance: F32
    cluster: I32


class MetalTriangles(NamedTuple):
    """The metallic part of the proxy's F triangles.

    Attributes:
        tint: [F + 1, 3] base colour times metallic, linear Rec.709; row -1 (OPEN) is 0.
        metallic: [F] 0..1.
        normal: [F, 3] unit, world.
        level: [F] index into LEVELS.
        wide: [F] the same for the direction of a whole cluster, which stands for all directions in it.
        occluders: [F, C, 3] radiance that comes to a triangle from occluded coarse light clusters; -1 where it sees
            the cluster.
    """

    tint: F32
    metallic: F32
    normal: F32
    level: I32
    wide: I32
    occluders: F32


class PixelRays(NamedTuple):
    """Directions in which P pixels meet the proxy.

    Attributes:
        hits: [P, C] triangle towards each light cluster, OPEN where there is none.
        direction: [3, C] unit, world, of the clusters.
        mirror: [P, 3] unit, world, mirrored view, which replaces the direction of one cluster per sharp pixel.
        mirror_cluster: [P] that cluster; -1 for none.
    """

    hits: I32
    direction: F32
    mirror: F32
    mirror_cluster: I32


@dataclass(frozen=True)
class IndirectLight:
    """Radiance that the proxy sends out under one light.

    Attributes:
        diffuse: [F + 1, 3] exitant radiance of the diffuse part of each triangle; row -1 (OPEN) is 0.
        metal: the metallic part.
        light: the light that the metal mirrors.
    """

    diffuse: F32
    metal: MetalTriangles
    light: MirroredLight

    def towards(self, rays: PixelRays) -> F32:
        """Radiance [3, P, C] that pixels receive along rays that meet triangles; 0 along the others."""
        out = np.zeros((3, *rays.hits.shape), dtype=np.float32)
        over_ranges(
            len(rays.hits),
            lambda first, last: _towards(first, last, rays, self.diffuse, self.metal, self.light, out),
        )
        return out


class ShownPixels(NamedTuple):
    """Pixels that the proxy takes its materials from.

    Attributes:
        pixels: P pixels of the frame.
        shown: [P] triangle behind each pixel, -1 where none.
        base: [P, 3] base colour of the pixels, linear, in the space of the lights.
    """

    pixels: Pixels
    shown: I32
    base: F32


def indirect_light(
    proxy: ProxyScene,
    source: ShownPixels,
    light: PreparedLight,
    settings: RelightSettings,
    surroundings: Surroundings | None = None,
) -> IndirectLight:
    """Lights the proxy, whose triangles take the materials of the pixels that show them.

    Args:
        proxy: the mesh, F triangles; those of the set, if there is one, are its last.
        source: pixels of the subject.
        light: that falls on the proxy.
        settings: of the stage, with at least one bounce.
        surroundings: the set, whose triangles have their own material; None: there is no set.
    """
    pixels, shown, base = source
    metallic = pixels.metallic[:, None]
    features = np.concatenate([base * (1 - metallic), base * metallic, pixels.roughness[:, None], metallic], axis=1)
    painted = proxy.paint(shown, features)
    if surroundings is not None:
        painted[-len(surroundings.mesh.faces) :] = surroundings.features()
    diffuse, tint, roughness = painted[:, :3], painted[:, 3:6], painted[:, 6]
    # A wide ground is mostly open: in the mean of all triangles it would hide what a bounce is worth to the subject.
    own = len(proxy.faces) - (len(surroundings.mesh.faces) if surroundings is not None else 0)
    albedo = diffuse + tint
    received, hits = proxy.gather(light.coarse, albedo, settings.bounce, settings.offset, settings.error, own)
    nothing = np.zeros((1, 3), np.float32)
    sent = np.concatenate([albedo * received, nothing]).astype(np.float32)
    level = nearest_level(roughness)
    occluders = np.where((hits == OPEN)[..., None], np.float32(-1), sent[hits])
    wide = level.copy()
    wide[own:] = np.maximum(level[own:], cluster_level(light))
    shines = tint.sum(axis=1) > _TINT
    used = tuple(np.unique([level[shines], wide[shines]]).tolist())
    tint = np.concatenate([tint, nothing]).astype(np.float32)
    metal = MetalTriangles(tint, painted[:, 7], proxy.normals, level, wide, occluders)
    exitant = np.concatenate([diffuse * received, nothing]).astype(np.float32)
    return IndirectLight(exitant, metal, mirrored_light(light, used))


def mirrored_light(light: PreparedLight, used: tuple[int, ...]) -> MirroredLight:
    """Filters a light for the levels `used` (indices into LEVELS); the others stay black."""
    radiance = np.zeros((len(LEVELS), ROWS, 2 * ROWS, 3), dtype=np.float32)
    for i in used:
        radiance[i] = _filtered(light, i)
    return MirroredLight(radiance, _nearest(light))


def nearest_level(roughness: NDArray[np.floating]) -> I32:
    """Index into LEVELS of the value nearest to each roughness [N], as [N] int32."""
    return np.abs(roughness[:, None] - np.array(LEVELS, np.float32)).argmin(axis=1).astype(np.int32)


def cluster_level(light: PreparedLight) -> int:
    """Index into LEVELS of the narrowest lobe that is as wide as a light cluster.

    A smooth floor mirrors a lamp into a few clusters. If each took what lies in its middle, the lamp would count as a
    whole number of clusters: 10 % too bright for a lamp of 16 degrees. Half of a GGX lobe lies within 2 alpha_ggx of
    the mirrored direction, half of a cluster of solid angle s within sqrt(s / (2 pi)).
    """
    half = np.sqrt(float(np.median(light.clusters.solid_angle)) / (2 * np.pi))
    return min(int(np.searchsorted(2 * np.square(LEVELS), half)), len(LEVELS) - 1)


def _directions() -> F32:
    down, across = (np.arange(ROWS)[:, None] + 0.5) / ROWS, (np.arange(2 * ROWS) + 0.5) / (2 * ROWS)
    return uv_to_direction(across, down).reshape(-1, 3).astype(np.float32)


@lru_cache(maxsize=4)
def _nearest(light: PreparedLight) -> I32:
    return light.coarse.nearest(_directions()).reshape(ROWS, 2 * ROWS)


@lru_cache(maxsize=4 * len(LEVELS))
def _filtered(light: PreparedLight, level: int) -> F32:
    """A light as metal of roughness LEVELS[level] mirrors it, [ROWS, 2 ROWS, 3]; computed once per light and level."""
    direction = _directions()
    size, full, whole = len(direction), np.ones(len(direction), np.float32), slice(0, len(direction))
    pixels = Pixels(np.arange(size), (1, size), direction, direction, direction, full * np.float32(LEVELS[level]), full)
    sums = normalise(sum_lobes(pixels.lobes(whole, "default"), light, None, None), pixels, whole)
    white = max(float(_albedo_at_normal()[level]), 1e-3)
    return ((sums[:, METAL_F0] + sums[:, METAL_F90]) / white).reshape(ROWS, 2 * ROWS, 3).astype(np.float32)


def _albedo_at_normal() -> F32:
    from yesnt.relight.albedo import albedo_tables

    tables, full = albedo_tables(), np.ones(len(LEVELS))
    return tables.lookup(tables.white, np.array(LEVELS), full).astype(np.float32)


@exact_entry
def _towards(first, last, rays, diffuse, metal, light, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes what pixels [first, last) receive to `out` [3, P, C], which is 0."""
    for p in range(first, last):
        for c in range(rays.hits.shape[1]):
            face = rays.hits[p, c]
            if face < 0:
                continue
            for k in range(3):
                out[k, p, c] = diffuse[face, k]
            if metal.tint[face, 0] + metal.tint[face, 1] + metal.tint[face, 2] > np.float32(_TINT):
                dx, dy, dz, level = rays.direction[0, c], rays.direction[1, c], rays.direction[2, c], metal.wide[face]
                if c == rays.mirror_cluster[p]:
                    level = metal.level[face]
                    dx, dy, dz = rays.mirror[p, 0], rays.mirror[p, 1], rays.mirror[p, 2]
                nx, ny, nz = metal.normal[face, 0], metal.normal[face, 1], metal.normal[face, 2]
                cos_o = dx * nx + dy * ny + dz * nz  # negative: the direction points to the triangle
                mirrored = (dx - 2 * cos_o * nx, dy - 2 * cos_o * ny, dz - 2 * cos_o * nz)
                row, column = _map_cell(mirrored, light.radiance.shape[1])
                schlick = (np.float32(1) - min(max(-cos_o, np.float32(0)), np.float32(1))) ** 5
                for k in range(3):
                    incident = metal.occluders[face, light.cluster[row, column], k]
                    if incident < 0:
                        incident = light.radiance[level, row, column, k]
                    fresnel = metal.tint[face, k] + schlick * (metal.metallic[face] - metal.tint[face, k])
                    out[k, p, c] += fresnel * incident


@exact_inlined
def _map_cell(direction, rows):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Row and column of a lat-long map of `rows` rows that a unit direction points to (docs/method.md section 1)."""
    x, y, z = direction
    v = np.arctan2(np.sqrt(x * x + y * y), z) / np.pi
    u = np.float32(0.5) - np.arctan2(y, x) / (np.float32(2) * np.pi)
    return min(int(v * rows), rows - 1), min(int(u * 2 * rows), 2 * rows - 1)
