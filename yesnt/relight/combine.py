"""From lobe sums to colour, and back: relighting and the removal of the capture light are the same linear form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709, luminance
from yesnt.relight.albedo import albedo_tables, disney_albedo, energy_terms, multiple_scattering
from yesnt.relight.brdf import F0_DIELECTRIC
from yesnt.relight.kernels import DIELECTRIC, IRRADIANCE, METAL_F0, METAL_F90, OPEN_LIGHT, WHITE
from yesnt.relight.points import Pixels

F32 = NDArray[np.float32]

_LEAST_RESPONSE = 1e-3
"""Radiance per unit base colour below which a plate pixel tells nothing about the base colour."""

_METAL_PASSES = 3  # the metal's compensation factor depends weakly on the base colour: 1e-4 after three passes


@dataclass(frozen=True)
class Response:
    """Radiance as a function of the base colour b, per pixel and channel, all [P, 3].

    diffuse = b * diffuse;  specular = fixed + factor(b) * (b * metal_f0 + metal_f90).

    Attributes:
        diffuse: what the base colour multiplies in the diffuse.
        fixed: specular that does not depend on the base colour.
        metal_f0: part of the metallic lobe that F0 multiplies.
        metal_f90: the rest of it.
        average: [P] mean albedo of the lobe, 1 for `brdf="paper"`.
        missing: [P] (1 - E)/E, 0 for `brdf="paper"`.
    """

    diffuse: F32
    fixed: F32
    metal_f0: F32
    metal_f90: F32
    average: F32
    missing: F32

    def metal_factor(self, base_color: F32) -> F32:
        """Multiple-scattering factor of the metallic lobe [P, 3]."""
        f_single = base_color + (1 - base_color) / 21.0  # mean of Schlick's Fresnel
        return 1 + multiple_scattering(f_single, self.average[:, None]) * self.missing[:, None]

    def specular(self, base_color: F32) -> F32:
        """Specular radiance [P, 3]."""
        return self.fixed + self.metal_factor(base_color) * (base_color * self.metal_f0 + self.metal_f90)

    def base_color(self, plate: F32) -> F32:
        """The b in [0, 1] whose radiance is `plate` [P, 3]: the inverse of `b * diffuse + specular(b)`.

        Where the response is below 1e-3 of the brightest possible (a black corner) the plate holds no colour: the
        denominator is held there, so that b fades to 0 instead of blowing up noise. b above 1 would create energy.
        """
        b = np.clip(plate, 0, 1)
        for _ in range(_METAL_PASSES):
            factor = self.metal_factor(b)
            rest = plate - self.fixed - factor * self.metal_f90
            b = np.clip(rest / np.maximum(self.diffuse + factor * self.metal_f0, _LEAST_RESPONSE), 0, 1)
        return b


def response(sums: F32, pixels: Pixels, brdf: str) -> Response:
    """Weights the lobe sums [P, 20] as the BRDF does.

    `paper`: F0 = 0.04 (1 - m) + b m for one lobe. `default`: the metallic share of a metal, the rest of a dielectric
    under its own layer, each compensated for multiple scattering.
    """
    metallic = pixels.metallic
    m, shown = metallic[:, None], 1 - metallic[:, None]
    irradiance = sums[:, IRRADIANCE] / np.float32(np.pi)
    if brdf == "paper":
        fixed = F0_DIELECTRIC * shown * sums[:, METAL_F0] + sums[:, METAL_F90]
        whole, nothing = np.ones_like(metallic), np.zeros_like(metallic)
        return Response(shown * irradiance, fixed, m * sums[:, METAL_F0], np.zeros_like(fixed), whole, nothing)
    terms = energy_terms(pixels.roughness, pixels.cos_o)
    layer, factor = (a[:, None].astype(np.float32) for a in (terms.layer, terms.dielectric))
    return Response(
        shown * layer * irradiance,
        shown * factor * sums[:, DIELECTRIC],
        m * sums[:, METAL_F0],
        m * sums[:, METAL_F90],
        terms.average.astype(np.float32),
        terms.missing.astype(np.float32),
    )


def normalise(sums: F32, pixels: Pixels, part: slice, diffuse: str = "lambert") -> F32:
    """Rescales each lobe so that uniform white gives its exact albedo, [P, 20].

    The sum then is a mean of the light, weighted by the lobe, times a tabulated integral: a lobe narrower than the
    texels sees the texel that it points at instead of all or nothing of it, and a white furnace stays white.
    """
    tables, roughness, cos_o = albedo_tables(), pixels.roughness[part], pixels.cos_o[part]
    white, dielectric, schlick = (
        tables.lookup(table, roughness, cos_o) for table in (tables.white, tables.dielectric, tables.schlick)
    )
    rough = np.ones_like(white) if diffuse == "lambert" else tables.lookup(disney_albedo(), roughness, cos_o)
    exact = np.stack([np.pi * rough, dielectric, white - schlick, schlick], axis=1)
    found = sums[:, WHITE]
    scale = np.where(found > 1e-20, exact / np.maximum(found, 1e-20), 0.0).astype(np.float32)
    return np.concatenate([sums[:, :12] * np.repeat(scale, 3, axis=1), sums[:, 12:] * np.tile(scale, 2)], axis=1)


def shadow_ratio(sums: F32, pixels: Pixels, base_color: F32, brdf: str) -> F32:
    """Luminance that reaches the camera over what would if nothing were occluded, [P] in [0, 1]; 1 where both are 0."""
    lit, free = (
        luminance(base_color * weights.diffuse + weights.specular(base_color))
        for weights in (response(grey, pixels, brdf) for grey in (_grey_sums(sums), _open_sums(sums)))
    )
    return np.clip(np.where(free > 1e-12, lit / np.maximum(free, 1e-12), 1.0), 0, 1).astype(np.float32)


def _grey_sums(sums: F32) -> F32:
    """The sums of what arrives, their luminance in all three channels."""
    weights = np.asarray(LUMINANCE_REC709, dtype=np.float32)
    return np.repeat(sums[:, :12].reshape(-1, 4, 3) @ weights, 3, axis=1)


def _open_sums(sums: F32) -> F32:
    """The sums of the unoccluded light, its luminance in all three channels."""
    return np.repeat(sums[:, OPEN_LIGHT], 3, axis=1)
