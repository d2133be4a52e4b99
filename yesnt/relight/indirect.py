"""What the proxy sends back to a pixel that it hides the light from: diffuse bounces, and what its metal mirrors.

A metal has no diffuse colour, so that radiosity alone would show it black in another metal. To a pixel a metal triangle
shows the map, filtered by the triangle's own lobe, along the mirrored direction; or, where the triangle is hidden from
there, what hides it, as a diffuse surface of the same colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from yesnt.relight.combine import normalise
from yesnt.relight.envmap import uv_to_direction
from yesnt.relight.kernels import METAL_F0, METAL_F90, sum_lobes
from yesnt.relight.lights import PreparedLight
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.settings import RelightSettings

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

LEVELS = (0.1, 0.25, 0.4, 0.6, 1.0)
"""Roughness that the mirrored map is filtered for: its lobe at normal incidence."""

ROWS = 48
"""Rows of the filtered maps: 3.75 degrees, finer than a light cluster."""


_TINT = 1e-3  # sum of a triangle's metallic base colour below which it mirrors nothing


@dataclass(frozen=True)
class MirroredLight:
    """A map as metal triangles show it.

    Attributes:
        radiance: [L, ROWS, 2 ROWS, 3] filtered by the lobes of LEVELS; world axes, the product's layout.
        cluster: [ROWS, 2 ROWS] the coarse cluster that each direction belongs to.
    """

    radiance: F32
    cluster: I32


@dataclass(frozen=True)
class Glow:
    """The proxy under one light.

    Attributes:
        radiance: [F + 1, 3] exitant, of the diffuse part; row -1 (OPEN) is 0.
        tint: [F + 1, 3] base colour times metallic; row -1 is 0.
        metallic: [F].
        normal: [F, 3] unit.
        level: [F] index into LEVELS.
        seen: [F, C, 3] radiance that comes to a triangle from hidden coarse clusters; negative where they are open.
        light: what it mirrors.
    """

    radiance: F32
    tint: F32
    metallic: F32
    normal: F32
    level: I32
    seen: F32
    light: MirroredLight

    def towards(self, hits: I32, directions: F32, mirror: F32, own: I32) -> F32:
        """Radiance [3, P, C] that pixels see where they look towards light clusters and meet triangles.

        Args:
            hits: [P, C] triangles, OPEN where there is none.
            directions: [3, C] of the clusters.
            mirror: [P, 3] directions that pixels look along instead, in one cluster of theirs:
            own: [P] that cluster, -1 for none.
        """
        out = np.zeros((3, *hits.shape), dtype=np.float32)
        mirrored = self.light.radiance, self.light.cluster, self.seen
        _towards(
            (hits, directions, mirror, own),
            self.radiance,
            (self.tint, self.metallic, self.normal, self.level),
            mirrored,
            out,
        )
        return out


def glow_of(
    proxy: ProxyScene, pixels: Pixels, shown: I32, base: F32, light: PreparedLight, settings: RelightSettings
) -> Glow:
    """The glow of a proxy whose triangles take the materials of the pixels [P] that show them.

    Args:
        proxy: the mesh.
        pixels: of the frame.
        shown: [P] triangle behind each pixel.
        base: [P, 3] base colour of the pixels.
        light: that falls on the proxy.
        settings: of the stage; at least one bounce.
    """
    metallic = pixels.metallic[:, None]
    features = np.concatenate([base * (1 - metallic), base * metallic, pixels.roughness[:, None], metallic], axis=1)
    painted = proxy.paint(shown, features)
    diffuse, tint, roughness = painted[:, :3], painted[:, 3:6], painted[:, 6]
    arrives, hits = proxy.gather(light.coarse, diffuse + tint, settings.bounce, settings.offset, settings.error)
    sent = np.concatenate([(diffuse + tint) * arrives, np.zeros((1, 3), np.float32)]).astype(np.float32)
    nothing = np.zeros((1, 3), np.float32)
    level = nearest_level(roughness)
    seen = np.where((hits == OPEN)[..., None], np.float32(-1), sent[hits])
    shining = np.concatenate([diffuse * arrives, nothing]).astype(np.float32)
    tinted = np.concatenate([tint, nothing]).astype(np.float32)
    used = tuple(np.unique(level[tint.sum(axis=1) > _TINT]).tolist())
    return Glow(shining, tinted, painted[:, 7], proxy.normals, level, seen, mirrored_light(light, used))


def mirrored_light(light: PreparedLight, used: tuple[int, ...]) -> MirroredLight:
    """A light filtered for some of LEVELS; the others stay black."""
    radiance = np.zeros((len(LEVELS), ROWS, 2 * ROWS, 3), dtype=np.float32)
    for i in used:
        radiance[i] = _filtered(light, i)
    return MirroredLight(radiance, _nearest(light))


def nearest_level(roughness: NDArray[np.floating]) -> I32:
    """Index into LEVELS of each roughness [N]."""
    return np.abs(roughness[:, None] - np.array(LEVELS, np.float32)).argmin(axis=1).astype(np.int32)


def _directions() -> F32:
    down, across = (np.arange(ROWS)[:, None] + 0.5) / ROWS, (np.arange(2 * ROWS) + 0.5) / (2 * ROWS)
    return uv_to_direction(across, down).reshape(-1, 3).astype(np.float32)


@lru_cache(maxsize=4)
def _nearest(light: PreparedLight) -> I32:
    return light.coarse.nearest(_directions()).reshape(ROWS, 2 * ROWS)


@lru_cache(maxsize=4 * len(LEVELS))
def _filtered(light: PreparedLight, level: int) -> F32:
    """A light as metal of roughness LEVELS[level] mirrors it [ROWS, 2 ROWS, 3]; once per light and level."""
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


@njit(cache=True, parallel=True, error_model="numpy")
def _towards(rays, radiance, metal, mirrored, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    hits, directions, mirror, own = rays
    tint, metallic, normal, level = metal
    for p in prange(hits.shape[0]):
        for c in range(hits.shape[1]):
            face = hits[p, c]
            if face < 0:
                continue
            for k in range(3):
                out[k, p, c] = radiance[face, k]
            if tint[face, 0] + tint[face, 1] + tint[face, 2] > np.float32(_TINT):
                dx, dy, dz = directions[0, c], directions[1, c], directions[2, c]
                if c == own[p]:
                    dx, dy, dz = mirror[p, 0], mirror[p, 1], mirror[p, 2]
                nx, ny, nz = normal[face, 0], normal[face, 1], normal[face, 2]
                facing = dx * nx + dy * ny + dz * nz
                turned = (dx - 2 * facing * nx, dy - 2 * facing * ny, dz - 2 * facing * nz)
                row, column = _cell(turned, mirrored[0].shape[1])
                grazing = (np.float32(1) - min(max(-facing, np.float32(0)), np.float32(1))) ** 5
                for k in range(3):
                    from_there = mirrored[2][face, mirrored[1][row, column], k]
                    if from_there < 0:
                        from_there = mirrored[0][level[face], row, column, k]
                    reflected = tint[face, k] + grazing * (metallic[face] - tint[face, k])
                    out[k, p, c] += reflected * from_there


@njit(cache=True, error_model="numpy", inline="always")
def _cell(direction, rows):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Row and column of a lat-long map of `rows` rows that a direction points to."""
    x, y, z = direction
    v = np.arctan2(np.sqrt(x * x + y * y), z) / np.pi
    u = np.float32(0.5) - np.arctan2(y, x) / (np.float32(2) * np.pi)
    return min(int(v * rows), rows - 1), min(int(u * 2 * rows), 2 * rows - 1)
