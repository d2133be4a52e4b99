"""Directional albedo of the GGX lobe, and the energy terms that Cycles' Principled builds from it.

Cycles scales a single-scattering GGX lobe by 1 + Fms (1 - E)/E with Fms = Fss Eavg / (1 - Fss (1 - Eavg)) (Kulla &
Conty 2017 as in Turquin 2019) and multiplies the diffuse below the dielectric layer by 1 minus the albedo of the layer.
The tables are integrals of the BRDF, computed once per process in a quarter of a second. So no data file can disagree
with the BRDF. Source: docs/method.md section 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.brdf import alpha_ggx, dielectric_fresnel, disney_diffuse, schlick_weight

Float = NDArray[np.floating]

_SIZE = 48
_SAMPLES = 1024


@dataclass(frozen=True)
class AlbedoTables:
    """Directional albedos of the GGX lobe, indexed by roughness, then by sqrt(cos_o), both evenly over [0, 1].

    The square root samples grazing angles densely, where the albedo changes fastest.

    Attributes:
        white: [R, M] directional albedo E with F = 1.
        dielectric: [R, M] with the Fresnel reflectance of IOR 1.5.
        schlick: [R, M] with F = (1 - cos_d)^5: the second term of the split sum; the first is white - schlick.
        average: [R] Eavg, cosine-weighted mean of `white`.
        fresnel_average: mean of the dielectric Fresnel reflectance, the integral of 2 F(c) c dc over [0, 1].
    """

    white: Float
    dielectric: Float
    schlick: Float
    average: Float
    fresnel_average: float

    def lookup(self, table: Float, roughness: Float, cos_o: Float) -> Float:
        """Bilinear value of a table [R, M] at roughness and cos_o in [0, 1], arrays of one shape."""
        size_r, size_m = table.shape
        x = np.clip(roughness, 0, 1) * (size_r - 1)
        y = np.sqrt(np.clip(cos_o, 0, 1)) * (size_m - 1)
        i, j = np.minimum(x.astype(np.int64), size_r - 2), np.minimum(y.astype(np.int64), size_m - 2)
        fx, fy = x - i, y - j
        low = table[i, j] * (1 - fy) + table[i, j + 1] * fy
        high = table[i + 1, j] * (1 - fy) + table[i + 1, j + 1] * fy
        return low * (1 - fx) + high * fx


def hammersley(count: int) -> tuple[Float, Float]:
    """Hammersley's `count` points in the unit square: (i + 0.5) / n [n] and the bit-reversed i [n]."""
    bits = np.arange(count, dtype=np.uint64)
    reverse = np.zeros(count)
    scale = 0.5
    while bits.any():
        reverse += scale * (bits & np.uint64(1))
        bits >>= np.uint64(1)
        scale *= 0.5
    return (np.arange(count) + 0.5) / count, reverse


@cache
def albedo_tables() -> AlbedoTables:
    """Computes the tables on first use; the same bits in every process."""
    roughness = np.linspace(0, 1, _SIZE)
    cosine = np.maximum(np.linspace(0, 1, _SIZE) ** 2, 1e-4)
    rows = [_row(float(alpha), cosine) for alpha in alpha_ggx(roughness)]
    white, dielectric, schlick = (np.stack([row[i] for row in rows]) for i in range(3))
    nodes, weights = np.polynomial.legendre.leggauss(32)
    mu = 0.5 * nodes + 0.5
    tables = AlbedoTables(white, dielectric, schlick, np.zeros(0), float((weights * mu * dielectric_fresnel(mu)).sum()))
    grid = np.broadcast_arrays(roughness[:, None], mu[None, :])
    average = (tables.lookup(white, *grid) * weights * mu).sum(axis=1)
    return AlbedoTables(white, dielectric, schlick, average, tables.fresnel_average)


@cache
def disney_albedo() -> Float:
    """Directional albedo [R, M] of Burley's diffuse with base colour 1, indexed as `AlbedoTables`."""
    roughness, cos_o = np.linspace(0, 1, _SIZE)[:, None, None], np.linspace(0, 1, _SIZE)[None, :, None] ** 2
    u1, u2 = hammersley(_SAMPLES)
    cos_i, azimuth = np.sqrt(u1), np.cos(2 * np.pi * u2)  # cosine-weighted directions
    cos_vl = cos_i * cos_o + np.sqrt((1 - cos_i**2) * (1 - cos_o**2)) * azimuth
    cos_d = np.sqrt(np.clip(0.5 * (1 + cos_vl), 0, 1))
    return np.concatenate([disney_diffuse(cos_i, cos_o, cos_d, r).mean(-1) for r in roughness])


def _row(alpha: float, cosine: Float) -> tuple[Float, Float, Float]:
    """Directional albedos [M] for F = 1, dielectric and Schlick: means of F G2/G1 over visible normals (Heitz 2018)."""
    u1, u2 = hammersley(_SAMPLES)
    view = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], axis=-1)[:, None, :]
    half = visible_normals(view, alpha, u1, u2)
    cos_d = (view * half).sum(-1)
    cos_i = 2 * cos_d * half[..., 2] - view[..., 2]
    a2, cos_o = alpha * alpha, view[..., 2]
    lambda_o = 0.5 * (np.sqrt(1 + a2 * (1 / cos_o**2 - 1)) - 1)
    lambda_i = 0.5 * (np.sqrt(1 + a2 * (1 / np.maximum(cos_i, 1e-9) ** 2 - 1)) - 1)
    share = np.where(cos_i > 0, (1 + lambda_o) / (1 + lambda_o + lambda_i), 0.0)
    fresnel = dielectric_fresnel(cos_d)
    return share.mean(1), (share * fresnel).mean(1), (share * schlick_weight(cos_d)).mean(1)


def visible_normals(view: Float, alpha: float, u1: Float, u2: Float) -> Float:
    """Samples [M, S, 3] of GGX's visible normals (Heitz 2018, listing 1) for views [M, 1, 3] in the x-z plane."""
    stretched = view * np.array([alpha, alpha, 1.0])
    stretched = stretched / np.linalg.norm(stretched, axis=-1, keepdims=True)
    first = np.array([0.0, 1.0, 0.0])
    second = np.cross(stretched, first)
    radius, angle = np.sqrt(u1), 2 * np.pi * u2
    along, across = radius * np.cos(angle), radius * np.sin(angle)
    lean = 0.5 * (1 + stretched[..., 2])
    across = (1 - lean) * np.sqrt(1 - along**2) + lean * across
    depth = np.sqrt(np.clip(1 - along**2 - across**2, 0, None))
    half = along[..., None] * first + across[..., None] * second + depth[..., None] * stretched
    half = half * np.array([alpha, alpha, 1.0])
    half[..., 2] = np.maximum(half[..., 2], 1e-9)
    return half / np.linalg.norm(half, axis=-1, keepdims=True)


@dataclass(frozen=True)
class EnergyTerms:
    """Energy factors of `brdf="default"`, per pixel.

    Attributes:
        missing: [...] (1 - E) / E of the white lobe: what single scattering loses, over what it keeps.
        average: [...] Eavg, mean albedo of the white lobe.
        dielectric: [...] multiple-scattering factor of the dielectric lobe.
        layer: [...] share of light that passes the dielectric layer to the diffuse below.
    """

    missing: Float
    average: Float
    dielectric: Float
    layer: Float


def energy_terms(roughness: Float, cos_o: Float) -> EnergyTerms:
    """Looks up the energy factors for roughness and cos_o in [0, 1], arrays of one shape."""
    tables = albedo_tables()
    white = np.maximum(tables.lookup(tables.white, roughness, cos_o), 1e-3)
    average = np.interp(np.clip(roughness, 0, 1), np.linspace(0, 1, len(tables.average)), tables.average)
    missing = np.clip((1 - white) / white, 0, None)
    factor = 1 + multiple_scattering(np.asarray(tables.fresnel_average), average) * missing
    layer = 1 - factor * tables.lookup(tables.dielectric, roughness, cos_o)
    return EnergyTerms(missing, average, factor, layer)


def multiple_scattering(f_single: Float, average: Float) -> Float:
    """Fms = Fss Eavg / (1 - Fss (1 - Eavg)): reflectance of light scattered more than once (Kulla & Conty 2017)."""
    return f_single * average / (1 - f_single * (1 - average))
