"""The BRDF of the set in single directions, with the terms that lobe sums of whole lights use (relight/combine.py)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight import brdf as reference
from yesnt.relight.albedo import albedo_tables, disney_albedo, energy_terms
from yesnt.relight.brdf import F0_DIELECTRIC, alpha_ggx
from yesnt.relight.combine import Response, response
from yesnt.relight.kernels import COLUMNS
from yesnt.relight.points import Pixels
from yesnt.relight.settings import RelightSettings

F32 = NDArray[np.float32]


class SetBrdf(NamedTuple):
    """The BRDF at P pixels of one material.

    Attributes:
        normal: [P, 3] unit, world.
        outgoing: [P, 3] unit, world, towards the camera.
        alpha: alpha_ggx.
        diffuse: [P, 3] diffuse BRDF, 1/sr.
        f0: [P, 3] factor of D V (1 - w), w Schlick's weight.
        f90: [P, 3] factor of D V w.
        dielectric: [P] factor of D V F, F the Fresnel reflectance of IOR 1.5.
        burley: Disney's roughness where the diffuse is Burley's, -1 where it is Lambert's.
    """

    normal: F32
    outgoing: F32
    alpha: float
    diffuse: F32
    f0: F32
    f90: F32
    dielectric: F32
    burley: float

    def towards(self, pixel: NDArray[np.intp], light: F32) -> tuple[F32, F32]:
        """Diffuse and specular f cos_i [R, 3] of pixels [R] in unit directions [R, 3] above their horizon."""
        normal, view = self.normal[pixel], self.outgoing[pixel]
        cos_i = np.maximum((normal * light).sum(axis=1), 0)
        cos_o = np.clip((normal * view).sum(axis=1), reference.COS_MIN, 1)
        cos_h, cos_d = reference.half_vector_terms(normal, light, view)
        alpha = np.full_like(cos_i, self.alpha)
        shape = reference.ggx_distribution(cos_h, alpha) * reference.smith_visibility(cos_i, cos_o, alpha) * cos_i
        weight = reference.schlick_weight(cos_d)[:, None]
        layer = (self.dielectric[pixel] * reference.dielectric_fresnel(cos_d))[:, None]
        specular = shape[:, None] * (layer + self.f0[pixel] * (1 - weight) + self.f90[pixel] * weight)
        diffuse = self.diffuse[pixel] * cos_i[:, None]
        if self.burley >= 0:
            diffuse = diffuse * reference.disney_diffuse(cos_i, cos_o, cos_d, np.full_like(cos_i, self.burley))[:, None]
        return diffuse.astype(np.float32), specular.astype(np.float32)


def set_brdf(pixels: Pixels, color: F32, settings: RelightSettings) -> SetBrdf:
    """The BRDF of pixels whose base colour is `color` [3]."""
    metallic, roughness = float(pixels.metallic[0]), float(pixels.roughness[0])
    count, shown = len(pixels.index), 1 - metallic
    whole, nothing = np.ones((count, 3), np.float32), np.zeros(count, np.float32)
    alpha = float(alpha_ggx(pixels.roughness[:1])[0])
    diffuse = whole * color * np.float32(shown / np.pi)
    if settings.brdf == "paper":
        f0 = whole * (F0_DIELECTRIC * shown + color * metallic)
        return SetBrdf(pixels.normal, pixels.view, alpha, diffuse, f0.astype(np.float32), whole, nothing, -1.0)
    terms = energy_terms(pixels.roughness, pixels.cos_o)
    metal = response(np.zeros((count, COLUMNS), np.float32), pixels, "default").metal_factor(whole * color) * metallic
    diffuse = diffuse * terms.layer[:, None]
    burley = -1.0
    if settings.diffuse == "disney":
        burley = roughness
    under, f0, f90, layer = (a.astype(np.float32) for a in (diffuse, metal * color, metal, shown * terms.dielectric))
    return SetBrdf(pixels.normal, pixels.view, alpha, under, f0, f90, layer, burley)


def uniform_response(pixels: Pixels, settings: RelightSettings) -> Response:
    """The response [P] to uniform light of radiance 1."""
    tables = albedo_tables()
    white, dielectric, schlick = (
        tables.lookup(table, pixels.roughness, pixels.cos_o)
        for table in (tables.white, tables.dielectric, tables.schlick)
    )
    rough = np.ones_like(white)
    if settings.diffuse == "disney":
        rough = tables.lookup(disney_albedo(), pixels.roughness, pixels.cos_o)
    exact = np.stack([np.pi * rough, dielectric, white - schlick, schlick], axis=1)
    sums = np.concatenate([np.repeat(exact, 3, axis=1), np.tile(exact, 2)], axis=1).astype(np.float32)
    return response(sums, pixels, settings.brdf)
