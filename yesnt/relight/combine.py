"""From lobe sums to radiance, and from radiance to base colour.

The BRDF is linear in the base colour, up to a weak factor of metals, so the removal of the capture light inverts the
form that relighting evaluates. Source: docs/method.md section 5.
"""

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
"""Radiance per unit base colour below which a pixel of the plate does not tell the base colour."""

_METAL_PASSES = 3  # the metal's compensation factor depends weakly on the base colour: 1e-4 after three passes


_UNEXPLAINED = 1e-3
"""Relative difference of plate and radiance that counts as a clamped base colour; rounding is far below it."""


@dataclass(frozen=True)
class Clamped:
    """Pixels whose base colour was clamped: to 1 and to 0."""

    above: int = 0
    below: int = 0


NOTHING_CLAMPED = Clamped()


@dataclass(frozen=True)
class Response:
    """Radiance of P pixels as a function of their base colour b, per channel, all [P, 3].

    L_diffuse = b * diffuse;  L_specular = fixed + factor(b) * (b * metal_f0 + metal_f90).

    Attributes:
        diffuse: diffuse radiance for b = 1.
        fixed: specular radiance that does not depend on b.
        metal_f0: part of the metallic lobe that F0 = b multiplies.
        metal_f90: the rest of that lobe.
        average: [P] Eavg of the lobe, 1 for `brdf="paper"`.
        missing: [P] (1 - E)/E, 0 for `brdf="paper"`.
    """

    diffuse: F32
    fixed: F32
    metal_f0: F32
    metal_f90: F32
    average: F32
    missing: F32

    def metal_factor(self, base_color: F32) -> F32:
        """Multiple-scattering factor [P, 3] of the metallic lobe for base colours [P, 3]."""
        f_single = base_color + (1 - base_color) / 21.0  # mean of Schlick's Fresnel
        return 1 + multiple_scattering(f_single, self.average[:, None]) * self.missing[:, None]

    def specular(self, base_color: F32) -> F32:
        """Specular radiance [P, 3] for base colours [P, 3]."""
        return self.fixed + self.metal_factor(base_color) * (base_color * self.metal_f0 + self.metal_f90)

    def base_color(self, plate: F32) -> F32:
        """Base colour [P, 3] in [0, 1] whose radiance is `plate` [P, 3]: the inverse of b * diffuse + specular(b).

        Where the response is below 1e-3 (a black corner) the plate does not tell the colour. The denominator is clamped
        there, so that b goes to 0 instead of amplifying noise. b is clamped to 1, above which it would create energy.
        """
        b = np.clip(plate, 0, 1)
        for _ in range(_METAL_PASSES):
            factor = self.metal_factor(b)
            rest = plate - self.fixed - factor * self.metal_f90
            b = np.clip(rest / np.maximum(self.diffuse + factor * self.metal_f0, _LEAST_RESPONSE), 0, 1)
        return b

    def clamped(self, plate: F32, base_color: F32) -> Clamped:
        """How many pixels of a plate [P, 3] no base colour in [0, 1] explains: it is brighter or darker than any."""
        radiance = base_color * self.diffuse + self.specular(base_color)
        above = (base_color >= 1) & (plate > radiance * (1 + _UNEXPLAINED))
        below = (base_color <= 0) & (plate < radiance * (1 - _UNEXPLAINED))
        return Clamped(int(above.any(axis=1).sum()), int(below.any(axis=1).sum()))


def response(sums: F32, pixels: Pixels, brdf: str) -> Response:
    """Weights lobe sums [P, 20] as the BRDF does.

    "paper": one lobe with F0 = 0.04 (1 - m) + b m. "default": the share m of a metal and 1 - m of a diffuse under a
    dielectric layer, each compensated for multiple scattering.

    Args:
        sums: of `frame.integrate`.
        pixels: P pixels.
        brdf: "paper" or "default".
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
    """Rescales each lobe so that uniform white gives its exact albedo; returns sums [P, 20].

    A sum is then a mean of the light, weighted by the lobe, times a tabulated albedo. A lobe narrower than the texels
    sees the texel that it points to instead of all or nothing of it, and a white furnace stays white.

    Args:
        sums: [P, 20] of `kernels.sum_lobes`.
        pixels: of the frame.
        part: range of P pixels.
        diffuse: "lambert" or "disney".
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
    """Luminance that reaches the camera over that without occlusion, [P] in [0, 1]; 1 where both are 0.

    Args:
        sums: [P, 20] lobe sums.
        pixels: P pixels.
        base_color: [P, 3].
        brdf: "paper" or "default".
    """
    lit, free = (
        luminance(base_color * weights.diffuse + weights.specular(base_color))
        for weights in (response(grey, pixels, brdf) for grey in (_grey_sums(sums), _open_sums(sums)))
    )
    return np.clip(np.where(free > 1e-12, lit / np.maximum(free, 1e-12), 1.0), 0, 1).astype(np.float32)


def _grey_sums(sums: F32) -> F32:
    """Sums [P, 12] of the light with occlusion, as luminance in all three channels."""
    weights = np.asarray(LUMINANCE_REC709, dtype=np.float32)
    return np.repeat(sums[:, :12].reshape(-1, 4, 3) @ weights, 3, axis=1)


def _open_sums(sums: F32) -> F32:
    """Sums [P, 12] of the light without occlusion, as luminance in all three channels."""
    return np.repeat(sums[:, OPEN_LIGHT], 3, axis=1)
