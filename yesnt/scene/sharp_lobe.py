"""What a glossy or mirroring set shows: rays along its lobe, several in a pixel, so that a reflection has soft edges.

Rays are drawn from the visible normals of GGX (Heitz 2018) by a Hammersley sequence, the same in every pixel and frame.
The light along them tells which share of the specular light is lost; how much there is tells the sum over the lobe.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.set_input import MIRROR
from yesnt.relight.albedo import hammersley, visible_normals
from yesnt.relight.brdf import COS_MIN, alpha_ggx, dielectric_fresnel
from yesnt.relight.combine import Response
from yesnt.relight.envmap import EnvMap, cell_moments
from yesnt.relight.points import Pixels
from yesnt.scene.pixel_parts import PARTS, PixelParts

F32 = NDArray[np.float32]
Places = NDArray[np.intp]

SHARP = 0.4
"""Roughness below which the lobe is followed: wider ones are seen by the samples of the light."""

FINE = 0.1
"""Roughness below which the light along the rays replaces the sum over texels, whose cells such a lobe would show."""

RAYS = 64
"""Rays of a lobe of a roughness from `MIRROR` on."""


class LobeRays(NamedTuple):
    """R = n K rays of n pixels.

    Attributes:
        origin: [R, 3] world metres.
        direction: [R, 3] unit, world.
        weight: [R] share of the pixel's lobe, up to a factor a pixel; 0 below the horizon.
        light: [R, 3] radiance of the map along it.
    """

    origin: F32
    direction: F32
    weight: F32
    light: F32


@dataclass(frozen=True)
class SharpLobe:
    """The lobes of P pixels.

    Attributes:
        pixels: the pixels, of one material.
        parts: their parts.
        env: the light's map.
        specular: [P, 3] specular radiance where nothing is in the way.
        albedo: [P, 3] specular radiance under uniform light of 1.
        offset: distance of the rays' origins from the set, metres.
    """

    pixels: Pixels
    parts: PixelParts
    env: EnvMap
    specular: F32
    albedo: F32
    offset: float

    @property
    def is_mirror(self) -> bool:
        """Whether there is one ray in each part of a pixel."""
        return bool(self.pixels.roughness[0] < MIRROR)

    def rays(self, some: Places) -> LobeRays:
        """Rays of pixels [n], pixel by pixel."""
        found = [self._part(some, k) for k in range(len(PARTS))]
        count = found[0].weight.size // max(len(some), 1)
        stacked = [
            np.stack([part[i].reshape(len(some), count, -1) for part in found], axis=1).reshape(-1, *part_shape)
            for i, part_shape in enumerate(((3,), (3,), (), (3,)))
        ]
        return LobeRays(*stacked)

    def _part(self, some: Places, part: int) -> LobeRays:
        pixels = self.pixels
        normal, roughness = pixels.normal[some].astype(np.float64), float(pixels.roughness[0])
        point, aim = self.parts.seen(pixels, part, some)
        point = point + np.float32(self.offset) * pixels.normal[some]
        slope = (aim * normal).sum(axis=1)
        cos_o = np.clip(-slope, COS_MIN, 1)
        first = -aim + slope[:, None] * normal
        first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
        axes = np.stack([first, np.cross(normal, first), normal], axis=1)
        half, weight = _lobe(cos_o, roughness, float(pixels.metallic[0]), part)
        local = 2 * half * (np.sqrt(1 - cos_o**2)[:, None] * half[..., 0] + cos_o[:, None] * half[..., 2])[..., None]
        local[..., 0] -= np.sqrt(1 - cos_o**2)[:, None]
        local[..., 2] -= cos_o[:, None]
        direction = (local @ axes).astype(np.float32)
        origin = np.broadcast_to(point[:, None], direction.shape).astype(np.float32)
        light = _filtered(self.env, roughness).lookup(direction)
        return LobeRays(origin, direction, weight.astype(np.float32), light)


def _lobe(cos_o: NDArray[np.float64], roughness: float, metallic: float, part: int) -> tuple[F32, F32]:
    """Half vectors [n, K, 3] in the frame of view and normal, and weights [n, K], for one part of the pixels."""
    view = np.stack([np.sqrt(1 - cos_o**2), 0 * cos_o, cos_o], axis=-1)[:, None, :]
    if roughness < MIRROR:
        half = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(cos_o), 1, 3))
    else:
        u1, u2 = hammersley(RAYS)
        half = visible_normals(view, float(alpha_ggx(np.array(roughness))), u1[part::4], u2[part::4])
    cos_d = np.clip((view * half).sum(-1), 0, 1)
    cos_i = 2 * cos_d * half[..., 2] - view[..., 2]
    fresnel = (1 - metallic) * dielectric_fresnel(cos_d) + metallic
    return half, np.where(cos_i > 0, _masking(cos_i, cos_o, roughness) * fresnel, 0.0)


def _masking(cos_i: NDArray[np.float64], cos_o: NDArray[np.float64], roughness: float) -> NDArray[np.float64]:
    """G2 / G1 of Smith's masking and shadowing: the weight of a direction drawn from the visible normals."""
    a2 = float(alpha_ggx(np.array(roughness))) ** 2
    lambda_i = 0.5 * (np.sqrt(1 + a2 * (1 / np.maximum(cos_i, 1e-9) ** 2 - 1)) - 1)
    lambda_o = 0.5 * (np.sqrt(1 + a2 * (1 / cos_o**2 - 1)) - 1)[:, None]
    return (1 + lambda_o) / (1 + lambda_o + lambda_i)


@lru_cache(maxsize=4)
def _filtered(env: EnvMap, roughness: float) -> EnvMap:
    """The map in texels about as wide as the distance of a lobe's rays; as it is for a mirror."""
    height = env.radiance.shape[0]
    rows = height if roughness < MIRROR else max(16, int(np.pi / roughness**2))
    if rows >= height:
        return env
    cells = cell_moments(env, (rows, 2 * rows))
    return replace(env, radiance=(cells[..., :3] / cells[..., 6:7] / env.gain).astype(np.float32))


def specular_albedo(white: Response, color: F32) -> F32:
    """Specular radiance [P, 3] under uniform light of 1, of the response to that light and base colour [3]."""
    base = np.broadcast_to(color, white.diffuse.shape).astype(np.float32)
    return white.specular(base)
