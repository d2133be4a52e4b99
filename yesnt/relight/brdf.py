"""Reference of the BRDF in NumPy, float64: written as in the papers; the compiled kernels are tested against it.

Directions are unit vectors [..., 3] that point away from the surface: n normal, v to the viewer, l to the light, h half
vector. cos_i = n.l, cos_o = n.v, cos_h = n.h, cos_d = v.h = l.h. Source: docs/method.md section 5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating]

ALPHA_MIN = 1e-3
"""Smallest alpha_ggx: below it D exceeds what float32 integrates (docs/method.md section 1)."""

F0_DIELECTRIC = 0.04
"""F0 of a dielectric of IOR 1.5, at normal incidence."""

IOR = 1.5
"""Index of refraction of the dielectric layer: the default of Cycles' Principled BSDF."""

COS_MIN = 1e-3
"""Smallest cos_o: interpolated normals may turn away from a camera that sees the pixel."""


def alpha_ggx(roughness: Float) -> Float:
    """Width a of GGX from Disney's roughness r in [0, 1], any shape: a = max(r^2, 1e-3)."""
    return np.maximum(np.square(np.clip(roughness, 0.0, 1.0)), ALPHA_MIN)


def ggx_distribution(cos_h: Float, alpha: Float) -> Float:
    """D, 1/sr: GGX distribution of normals (Walter 2007, eq. 33; the caller excludes cos_h < 0)."""
    a2 = alpha * alpha
    return a2 / (np.pi * np.square(np.square(cos_h) * (a2 - 1) + 1))


def smith_visibility(cos_i: Float, cos_o: Float, alpha: Float) -> Float:
    """G2 / (4 cos_i cos_o): height-correlated masking and shadowing of Smith for GGX (Heitz 2014, eq. 99)."""
    a2 = alpha * alpha
    term_i = cos_o * np.sqrt(cos_i * cos_i * (1 - a2) + a2)
    term_o = cos_i * np.sqrt(cos_o * cos_o * (1 - a2) + a2)
    return 0.5 / np.maximum(term_i + term_o, 1e-30)


def schlick_weight(cos_d: Float) -> Float:
    """Weight w = (1 - cos_d)^5 of Schlick's Fresnel F = F0 (1 - w) + w (Schlick 1994)."""
    return (1 - np.clip(cos_d, 0, 1)) ** 5


def disney_diffuse(cos_i: Float, cos_o: Float, cos_d: Float, roughness: Float) -> Float:
    """Pi times Burley's diffuse BRDF of base colour 1 (Burley 2012, section 5.3): F_D90 = 0.5 + 2 r cos_d^2."""
    grazing = 2 * roughness * np.square(cos_d) - 0.5
    return (1 + grazing * schlick_weight(cos_i)) * (1 + grazing * schlick_weight(cos_o))


def dielectric_fresnel(cos_d: Float, ior: float = IOR) -> Float:
    """F: unpolarised Fresnel reflectance of a smooth dielectric of index `ior` (Walter 2007, eq. 22)."""
    c = np.clip(cos_d, 0, 1)
    g = np.sqrt(ior * ior - 1 + c * c)
    return 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)


def half_vector_terms(normal: Float, light: Float, view: Float) -> tuple[Float, Float]:
    """Returns cos_h and cos_d of unit directions [..., 3]."""
    half = light + view
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-30)
    return (normal * half).sum(-1), (view * half).sum(-1)


def evaluate_paper(
    normal: Float, light: Float, view: Float, base_color: Float, roughness: Float, metallic: Float
) -> tuple[Float, Float]:
    """The BRDF of `brdf="paper"`: diffuse and specular f [..., 3], 1/sr; 0 if l or v lies below the horizon.

    f_d = (1 - m) b / pi;  f_s = D F G2 / (4 cos_i cos_o), F of Schlick with F0 = 0.04 (1 - m) + b m.

    Args:
        normal: n, [..., 3] unit.
        light: l, [..., 3] unit.
        view: v, [..., 3] unit.
        base_color: b, [..., 3] linear Rec.709, 0..1.
        roughness: r, [...] Disney's, 0..1.
        metallic: m, [...] 0..1.
    """
    cos_i, cos_o = (normal * light).sum(-1), (normal * view).sum(-1)
    cos_h, cos_d = half_vector_terms(normal, light, view)
    alpha, above = alpha_ggx(roughness), (cos_i > 0) & (cos_o > 0)
    shape = ggx_distribution(cos_h, alpha) * smith_visibility(np.maximum(cos_i, 0), np.maximum(cos_o, 0), alpha)
    f0 = F0_DIELECTRIC * (1 - metallic)[..., None] + base_color * metallic[..., None]
    weight = schlick_weight(cos_d)[..., None]
    specular = (shape * above)[..., None] * (f0 * (1 - weight) + weight)
    diffuse = ((1 - metallic) * above)[..., None] * base_color / np.pi
    return diffuse, specular
