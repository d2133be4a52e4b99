"""The BRDF in plain NumPy float64: what a reader holds against the paper and every fast kernel is tested against.

Directions are unit vectors [..., 3] away from the surface; `cos_i` = n.l, `cos_o` = n.v, `cos_d` = v.h.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating]

ALPHA_MIN = 1e-3
"""Smallest alpha_ggx: below it D exceeds what float32 integrates (method.md section 1)."""

F0_DIELECTRIC = 0.04
"""Normal reflectance of IOR 1.5."""

IOR = 1.5
"""Index of refraction of the dielectric layer: Principled's default."""

COS_MIN = 1e-3
"""Smallest n.v: interpolated normals may turn away from a camera that sees the pixel all the same."""


def alpha_ggx(roughness: Float) -> Float:
    """GGX width from Disney's roughness: max(r^2, 1e-3); the only place that knows."""
    return np.maximum(np.square(np.clip(roughness, 0.0, 1.0)), ALPHA_MIN)


def ggx_distribution(cos_h: Float, alpha: Float) -> Float:
    """D (Walter 2007, eq. 33 with chi+ left to the caller)."""
    a2 = alpha * alpha
    return a2 / (np.pi * np.square(np.square(cos_h) * (a2 - 1) + 1))


def smith_visibility(cos_i: Float, cos_o: Float, alpha: Float) -> Float:
    """G2 / (4 cos_i cos_o), height-correlated (Heitz 2014, eq. 99)."""
    a2 = alpha * alpha
    term_i = cos_o * np.sqrt(cos_i * cos_i * (1 - a2) + a2)
    term_o = cos_i * np.sqrt(cos_o * cos_o * (1 - a2) + a2)
    return 0.5 / np.maximum(term_i + term_o, 1e-30)


def schlick_weight(cos_d: Float) -> Float:
    """(1 - v.h)^5 (Schlick 1994): F = F0 (1 - w) + w."""
    return (1 - np.clip(cos_d, 0, 1)) ** 5


def disney_diffuse(cos_i: Float, cos_o: Float, cos_d: Float, roughness: Float) -> Float:
    """Pi times the diffuse f of base colour 1 (Burley 2012, section 5.3): F_D90 = 0.5 + 2 roughness cos_d^2."""
    grazing = 2 * roughness * np.square(cos_d) - 0.5
    return (1 + grazing * schlick_weight(cos_i)) * (1 + grazing * schlick_weight(cos_o))


def dielectric_fresnel(cos_d: Float, ior: float = IOR) -> Float:
    """Unpolarised reflectance of a smooth dielectric (Walter 2007, eq. 22)."""
    c = np.clip(cos_d, 0, 1)
    g = np.sqrt(ior * ior - 1 + c * c)
    return 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)


def half_vector_terms(normal: Float, light: Float, view: Float) -> tuple[Float, Float]:
    """n.h and v.h of unit directions."""
    half = light + view
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-30)
    return (normal * half).sum(-1), (view * half).sum(-1)


def evaluate_paper(
    normal: Float, light: Float, view: Float, base_color: Float, roughness: Float, metallic: Float
) -> tuple[Float, Float]:
    """`brdf="paper"`: diffuse and specular f [..., 3], 1/sr; 0 below either horizon (method.md section 5)."""
    cos_i, cos_o = (normal * light).sum(-1), (normal * view).sum(-1)
    cos_h, cos_d = half_vector_terms(normal, light, view)
    alpha, above = alpha_ggx(roughness), (cos_i > 0) & (cos_o > 0)
    shape = ggx_distribution(cos_h, alpha) * smith_visibility(np.maximum(cos_i, 0), np.maximum(cos_o, 0), alpha)
    f0 = F0_DIELECTRIC * (1 - metallic)[..., None] + base_color * metallic[..., None]
    weight = schlick_weight(cos_d)[..., None]
    specular = (shape * above)[..., None] * (f0 * (1 - weight) + weight)
    diffuse = ((1 - metallic) * above)[..., None] * base_color / np.pi
    return diffuse, specular
