"""Capture light of the synthetic scenes: nearly uniform with soft boxes, prefiltered for every roughness.

Directions are image axes (x right, y down, z to the camera). Maps are lat-long with row 0 up (-y) and the centre column
along +z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

ROWS, COLUMNS = 32, 64
"""Texels of a light map."""

LEVELS = np.linspace(0.05, 1.0, 8)
"""Disney roughness of the prefiltered specular maps."""


@dataclass(frozen=True)
class Light:
    """Prefiltered light.

    Attributes:
        diffuse: [ROWS, COLUMNS, 3] irradiance / pi by normal.
        specular: [len(LEVELS), ROWS, COLUMNS, 3] mean radiance in the GGX lobe by direction of reflection.
    """

    diffuse: Float32
    specular: Float32


def draw_light(rng: np.random.Generator) -> Light:
    """Draws a prefiltered light with mean radiance 1."""
    return prefiltered(draw_radiance(rng))


def draw_radiance(rng: np.random.Generator) -> Float64:
    """Draws a light map [ROWS, COLUMNS, 3] with mean radiance 1: wide panels, or soft boxes, with equal probability."""
    direction = _directions()
    radiance = np.ones((ROWS, COLUMNS, 3))
    if rng.random() < 0.5:
        radiance *= np.clip(1 + direction @ (rng.normal(0, 0.15) * _towards(rng)), 0.15, None)[..., None]
        for _ in range(rng.integers(0, 7)):
            panel = np.exp(rng.uniform(3, 9) * (direction @ _towards(rng) - 1))
            radiance += rng.uniform(0.1, 0.6) * panel[..., None]
        return radiance / np.average(radiance.mean(2), weights=_solid_angles())
    slope = rng.normal(0, 0.35) * _towards(rng) + np.array([0, -abs(rng.normal(0, 0.3)), 0])
    radiance *= np.clip(1 + direction @ slope, 0.15, None)[..., None]
    for _ in range(rng.choice([0, 1, 2, 3, 4, 6], p=[0.12, 0.15, 0.25, 0.22, 0.16, 0.10])):
        radiance += _soft_box(rng, direction)[..., None] * np.exp(rng.normal(0, 0.06, 3))
    return radiance / np.average(radiance.mean(2), weights=_solid_angles())


def prefiltered(radiance: Float64) -> Light:
    """Filters a map [ROWS, COLUMNS, 3] for every normal and roughness (split-sum approximation, Karis 2013)."""
    kernels = _kernels()
    spectrum = np.fft.rfft(radiance, axis=1)
    product = kernels @ spectrum.transpose(1, 0, 2)  # [k, f, i, j] @ [f, j, c]
    filtered = np.fft.irfft(product.transpose(0, 2, 1, 3), n=COLUMNS, axis=2).astype(np.float32)
    return Light(np.ascontiguousarray(filtered[0]), np.ascontiguousarray(filtered[1:]))


def _soft_box(rng: np.random.Generator, direction: Float64) -> Float64:
    """Map of a round lamp. Its irradiance is drawn, so that small lamps are bright."""
    towards = _towards(rng)
    radius = np.deg2rad(np.exp(rng.uniform(np.log(4), np.log(32))))
    cosine = direction @ towards
    lamp = 0.5 + 0.5 * np.tanh((cosine - np.cos(radius)) / (0.5 * (1 - np.cos(radius))))
    irradiance = float((lamp * np.maximum(cosine, 0) * _solid_angles()).sum() / np.pi)
    return lamp * (np.exp(rng.uniform(np.log(0.03), np.log(0.6))) / max(irradiance, 1e-3))


def _towards(rng: np.random.Generator) -> Float64:
    """Unit direction, more often in front and above."""
    vector = rng.standard_normal(3) + np.array([0, -0.4, 0.5])
    return vector / np.linalg.norm(vector)


@cache
def _directions() -> Float64:
    theta, phi = (np.arange(ROWS) + 0.5) * np.pi / ROWS, (np.arange(COLUMNS) + 0.5) * 2 * np.pi / COLUMNS - np.pi
    s = np.sin(theta)[:, None]
    return np.stack([s * np.sin(phi), -np.cos(theta)[:, None] + 0 * phi, s * np.cos(phi)], -1)


@cache
def _solid_angles() -> Float64:
    edges = np.cos(np.arange(ROWS + 1) * np.pi / ROWS)
    return np.repeat((edges[:-1] - edges[1:])[:, None], COLUMNS, 1) * (2 * np.pi / COLUMNS)


@cache
def _kernels() -> NDArray[np.complex128]:
    """Spectra [1 + levels, frequency, row out, row in] of zonal kernels, which are circulant in longitude.

    Kernel 0 is the clamped cosine over pi. The others are D(h) (n.l) with n = v = r (split-sum prefiltering, Karis
    2013), each normalised to sum to 1.
    """
    directions = _directions()
    cosine = np.einsum("ic,jkc->ijk", directions[:, COLUMNS // 2], directions)
    lobes = [np.maximum(cosine, 0)]
    for roughness in LEVELS:
        alpha2 = max(float(roughness) ** 4, 4e-4)  # no sharper than the map can hold
        half2 = (1 + cosine) / 2
        lobes.append(np.maximum(cosine, 0) / (half2 * (alpha2 - 1) + 1) ** 2)
    kernels = np.stack(lobes) * _solid_angles()[None, None]
    kernels /= kernels.sum((2, 3), keepdims=True)
    # Column COLUMNS/2 is the output longitude; the kernel is even in longitude, so no reversal is needed.
    return np.ascontiguousarray(np.fft.rfft(np.roll(kernels, -(COLUMNS // 2), axis=3), axis=3).transpose(0, 3, 1, 2))


@cache
def environment_brdf(size: int = 32, samples: int = 256) -> Float32:
    """Directional albedo of GGX, split by Schlick's Fresnel: albedo = F0 * table[..., 0] + table[..., 1].

    Height-correlated Smith masking-shadowing (Heitz 2014), stratified half vectors.

    Args:
        size: samples per axis.
        samples: half vectors per entry.

    Returns:
        [size, size, 2] over (n.v, roughness) at (i + 0.5) / size.
    """
    mu = ((np.arange(size) + 0.5) / size)[:, None, None]
    alpha = np.maximum(((np.arange(size) + 0.5) / size) ** 2, 1e-3)[None, :, None]
    i = np.arange(samples)
    u1, phi = (i + 0.5) / samples, 2 * np.pi * ((i * 0.6180339887498949) % 1)
    cos_h = np.sqrt((1 - u1) / (1 + (alpha**2 - 1) * u1))
    sin_h = np.sqrt(np.maximum(0, 1 - cos_h**2))
    vh = np.sqrt(1 - mu**2) * sin_h * np.cos(phi) + mu * cos_h
    nl = 2 * vh * cos_h - mu
    seen = (nl > 0) & (vh > 0)
    nl = np.where(seen, nl, 1)

    def root(x: Float64) -> Float64:
        return np.sqrt(alpha**2 + (1 - alpha**2) * x**2)

    visible = 2 * nl / (nl * root(mu) + mu * root(nl))
    weight = np.where(seen, visible * vh / cos_h, 0)
    fresnel = (1 - np.clip(vh, 0, 1)) ** 5
    return np.stack([(weight * (1 - fresnel)).mean(2), (weight * fresnel).mean(2)], -1).astype(np.float32)
