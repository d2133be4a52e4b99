"""Estimates the capture light from all cameras of a capture, if no capture map is given.

Points of the proxy that have the same chromaticity are compared in pairs: where both have one albedo, the ratio of what
the cameras see is the ratio of their irradiances. Pairs of different albedo, and surfaces that mirror, are outliers of
a robust fit. Irradiance is linear in the light's harmonics of bands 0 to 2 (Ramamoorthi & Hanrahan 2001, "An efficient
representation for irradiance environment maps"), with what the proxy occludes, and what it sends in its place, taken
into account. Albedo and light are determined only up to a factor per channel, so the mean radiance is 1 in each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.observe import SeenView, sample_view
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.evidence.triangles import proxy_size, shown_radiance
from yesnt.relight.envmap import EnvMap, uv_to_direction
from yesnt.relight.harmonics import TERMS, basis
from yesnt.relight.lights import Clusters
from yesnt.relight.proxy import OPEN, ProxyScene

F32 = NDArray[np.float32]
Float = NDArray[np.float64]

FACES = 3000
"""Triangles of a frame that are looked at, evenly over its area."""

DIRECTIONS = 256
"""In which a triangle looks for what occludes it."""

PAIRS = 40_000
"""Most pairs of a frame; as many as 12 times are drawn."""

SAME_CHROMA = 0.05
"""Difference of log chromaticity below which two points may have one albedo."""

SPREAD = 0.2
"""Standard deviation of the light over directions, of its mean, that is expected before anything is seen."""

INDEPENDENT = 100
"""Pairs that tell as if they were independent; the others repeat them."""

_LEAST_VIEWS = 2  # with one camera a highlight is not told from the rest
_QUANTILE = 0.25  # of what the cameras see: below highlights
_GLOSS = 0.1  # relative deviation among cameras at which a point counts half
_FREEDOM = 4.0
_LEAST_SCALE = 0.02  # of a log ratio: no picture is better
_PASSES, _DAMPING = 15, 0.7
_DARK = 1e-3  # radiance of which no ratio is taken
_LEAST_LIGHT = 1e-2  # irradiance under harmonics that ring below 0
_FLOOR = 0.05  # least radiance, of the mean
_DIGITS = 4  # results are rounded, so that no library's last bit reaches a pixel
_MEAN = 0.5 / np.sqrt(np.pi)  # the first harmonic


@dataclass(frozen=True)
class LitFaces:
    """N triangles of a frame.

    Attributes:
        color: [N, 3] what the cameras see, below highlights.
        transfer: [N, 9] irradiance by each harmonic of the light.
        received: [N, 3] irradiance from the subject itself.
        weight: [N] in [0, 1]; small where the cameras see different radiances, as of metals.
    """

    color: Float
    transfer: Float
    received: Float
    weight: Float


def estimate_light(frames: Sequence[tuple[list[SeenView], ProxyScene]], settings: EvidenceSettings) -> EnvMap:
    """The capture light of a shot, [16, 32] with mean radiance 1; uniform if nothing tells of it.

    Pure and deterministic.

    Args:
        frames: cameras, the plate among them, and proxy of some frames.
        settings: of the evidence: when a camera sees a point.
    """
    faces = [lit_faces(views, proxy, settings) for views, proxy in frames]
    pairs = [same_albedo(one) for one in faces]
    light = np.zeros((TERMS, 3))
    light[0] = 1 / _MEAN
    if sum(len(first) for first, _ in pairs):
        for k in range(3):
            light[1:, k] = fit_harmonics(faces, pairs, k)
    direction = uv_to_direction((np.arange(32)[None, :] + 0.5) / 32, (np.arange(16)[:, None] + 0.5) / 16)
    return EnvMap.from_array(np.maximum(basis(direction) @ light.round(_DIGITS), _FLOOR))


def lit_faces(views: list[SeenView], proxy: ProxyScene, settings: EvidenceSettings) -> LitFaces:
    """Triangles that at least two cameras see, evenly over the area of the proxy."""
    size, chosen = proxy_size(proxy), _even_faces(proxy)
    at = proxy.centres[chosen], proxy.normals[chosen]
    samples = [sample_view(seen, *at, size, settings) for seen in views]
    valid = np.stack([one.valid for one in samples], axis=1)
    few = np.flatnonzero(valid.sum(axis=1) >= _LEAST_VIEWS)
    shown = np.stack([one.radiance for one in samples], axis=1)[few].astype(np.float64)
    shown = np.where(valid[few, :, None], shown, np.nan)
    if not len(few):
        return LitFaces(np.zeros((0, 3)), np.zeros((0, TERMS)), np.zeros((0, 3)), np.zeros(0))
    color, gray = np.nanquantile(shown, _QUANTILE, axis=1), shown.mean(axis=2)
    gloss = np.nanstd(gray, axis=1) / np.maximum(np.nanmean(gray, axis=1), _DARK)
    lit = color.min(axis=1) > _DARK
    light = transfer_of(proxy, at[0][few], at[1][few], shown_radiance(proxy, views, settings))
    return LitFaces(color[lit], light[0][lit], light[1][lit], 1 / (1 + (gloss[lit] / _GLOSS) ** 2))


def _even_faces(proxy: ProxyScene) -> NDArray[np.intp]:
    """Numbers of triangles, evenly over the area; without degenerate ones."""
    a, b, c = (proxy.vertices[proxy.faces[:, i]].astype(np.float64) for i in range(3))
    reached = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    chosen = np.unique(np.searchsorted(reached, (np.arange(FACES) + 0.5) / FACES * reached[-1]))
    return chosen[np.linalg.norm(proxy.normals[chosen], axis=1) > 0.5]


def transfer_of(proxy: ProxyScene, centre: F32, normal: F32, shown: F32) -> tuple[Float, Float]:
    """Irradiance of triangles by each harmonic of the light [N, 9], and from the subject itself [N, 3]."""
    direction = _sphere(DIRECTIONS)
    solid = 4 * np.pi / DIRECTIONS
    rays = Clusters(
        np.ascontiguousarray(direction.T, np.float32), np.ones((3, DIRECTIONS), np.float32),
        np.full(DIRECTIONS, solid, np.float32), np.zeros(DIRECTIONS, np.float32), np.zeros(DIRECTIONS, np.float32),
    )  # fmt: skip
    origin = centre + np.float32(1e-3 * proxy_size(proxy)) * normal  # off its own triangle
    hits = proxy.cluster_hits(origin, normal, rays)
    cosine = np.maximum(normal.astype(np.float64) @ direction.T, 0) * solid
    blocked = hits != OPEN
    received = np.stack([(cosine * blocked * shown[hits, k]).sum(axis=1) for k in range(3)], axis=1)
    return (cosine * ~blocked) @ basis(direction), received


def _sphere(count: int) -> Float:
    """Directions [count, 3], evenly over the sphere (a Fibonacci lattice)."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def same_albedo(faces: LitFaces) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of triangles of one chromaticity, as two lists of numbers; always the same ones."""
    rng, count = np.random.Generator(np.random.Philox(0)), len(faces.color)
    if count < 2:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    first, second = rng.integers(0, count, (2, 12 * PAIRS))
    chroma = np.log(faces.color)
    chroma -= chroma.mean(axis=1, keepdims=True)
    alike = (first != second) & (np.abs(chroma[first] - chroma[second]).max(axis=1) < SAME_CHROMA)
    return first[alike][:PAIRS], second[alike][:PAIRS]


def fit_harmonics(
    faces: Sequence[LitFaces], pairs: Sequence[tuple[NDArray[np.intp], NDArray[np.intp]]], channel: int
) -> Float:
    """Harmonics of bands 1 and 2 [8] of the light in one channel, of mean radiance 1.

    Gauss-Newton on the log ratios of pairs, weighted by Student's t distribution with 4 degrees of freedom.
    """
    found, precision = np.zeros(TERMS - 1), 1 / (SPREAD**2 * 4 * np.pi / (TERMS - 1))
    for _ in range(_PASSES):
        error, design, weight = (np.concatenate(a) for a in zip(
            *(_ratios(one, pair, channel, found) for one, pair in zip(faces, pairs, strict=True)), strict=True
        ))  # fmt: skip
        scale = max(1.4826 * float(np.median(np.abs(error))), _LEAST_SCALE)
        weight = weight * (_FREEDOM + 1) / (_FREEDOM + (error / scale) ** 2)
        worth = INDEPENDENT / max(float(weight.sum()), 1e-9) / scale**2
        matrix = worth * (design.T @ (weight[:, None] * design)) + precision * np.eye(TERMS - 1)
        found = found + _DAMPING * np.linalg.solve(matrix, worth * (design.T @ (weight * error)) - precision * found)
    return found


def _ratios(
    faces: LitFaces, pair: tuple[NDArray[np.intp], NDArray[np.intp]], k: int, light: Float
) -> tuple[Float, Float, Float]:
    """Log ratios of pairs over those that the light predicts [Q], their derivatives [Q, 8], and weights [Q]."""
    first, second = pair
    irradiance = faces.transfer @ np.concatenate([[1 / _MEAN], light]) + faces.received[:, k]
    irradiance = np.maximum(irradiance, _LEAST_LIGHT)
    slope = faces.transfer[:, 1:] / irradiance[:, None]
    level = np.log(faces.color[:, k] / irradiance)
    return level[first] - level[second], slope[first] - slope[second], faces.weight[first] * faces.weight[second]
