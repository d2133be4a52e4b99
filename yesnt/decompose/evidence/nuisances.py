"""What the cameras and the capture map get wrong together: a gain per camera and channel, a smooth factor of the light.

Both are fitted at a few points of a frame, each at its best candidate, so that the same frame gives the same result on
any worker. The base colour of every point is free: its column is projected out of the least squares (variable
projection, Golub & Pereyra 1973). A lobe sees the factor where it points, blurred by its width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.reference import LEAST_SQUARE, best_base_color, linear_form
from yesnt.decompose.evidence.settings import EvidenceSettings, metallic_levels
from yesnt.relight.brdf import alpha_ggx
from yesnt.relight.envmap import EnvMap, uv_to_direction
from yesnt.relight.harmonics import BANDS, TERMS, basis

Float = NDArray[np.floating]

_BAND = np.repeat([0, 1, 2], [1, 3, 5])
_FREE = TERMS - 1  # a factor that is constant is a brighter base colour
_LEAST_FACTOR = 0.3  # of the map: a correction explains no dark half of a room
_DIGITS = 4  # results are rounded, so that no library's last bit reaches a pixel


@dataclass(frozen=True)
class Nuisances:
    """Corrections of V views and of the light.

    Attributes:
        gain: [V, 3] radiance over what it should be.
        light: [9] harmonics of the factor of the map minus 1; the first is 0.
    """

    gain: Float
    light: Float

    def then(self, other: Nuisances) -> Nuisances:
        """These corrections, and others that were found with them applied."""
        return Nuisances(self.gain * other.gain, self.light + other.light)


def corrected_map(env: EnvMap, light: Float) -> EnvMap:
    """The map times its factor."""
    height, width = env.radiance.shape[:2]
    way = uv_to_direction((np.arange(width) + 0.5) / width, (np.arange(height)[:, None] + 0.5) / height)
    factor = np.maximum(1 + basis(way @ env.world_from_map.T) @ light, _LEAST_FACTOR)
    radiance = (env.radiance * factor[..., None]).astype(np.float32)
    return EnvMap(radiance, env.rotation, env.exposure)


def fit_nuisances(
    seen: Observations,
    of: Responses,
    ways: tuple[Float, Float],
    chosen: tuple[Float, Float],
    settings: EvidenceSettings,
) -> Nuisances:
    """One step towards the gains and the light.

    Args:
        seen: what V cameras saw of P points.
        of: responses for the levels of roughness.
        ways: normals [P, 3] and directions to the cameras [P, V, 3], unit.
        chosen: minus the log probability of every candidate [P, R, M], and the R levels of roughness.
        settings: `gain_error`, `light_error` and `independent`.
    """
    cost, levels = chosen
    best, metallic = cost.reshape(len(cost), -1).argmin(axis=1), metallic_levels(settings)
    normals, left = _Normals(seen.valid.shape[1], settings), seen.valid.any(axis=1)
    weight = min(1.0, settings.independent / max(int(left.sum()), 1))
    for candidate in np.unique(best[left]):
        these = left & (best == candidate)
        r, m = divmod(int(candidate), len(metallic))
        part = Observations(*(a[these] for a in seen))
        lobes = Responses(
            of.diffuse[these], of.dielectric[these], of.metal_f0[these], of.metal_f90[these], of.missing[these],
            of.average,
        )  # fmt: skip
        columns = _lobe_harmonics(ways[0][these], ways[1][these], float(levels[r]))
        normals.add(part, lobes, columns, (r, metallic[m]), weight)
    return normals.solved()


def _lobe_harmonics(normal: Float, towards: Float, level: float) -> tuple[Float, Float]:
    """Harmonics that the diffuse [P, 1, 8] and the specular lobe [P, V, 8] see, blurred by the lobe."""
    clamped = (np.array(BANDS) / BANDS[0])[_BAND]
    alpha = float(alpha_ggx(np.array(level)))
    blurred = np.exp(-alpha * alpha * _BAND * (_BAND + 1.0))  # a Gaussian of variance 2 alpha^2 about the mirrored view
    mirrored = 2 * (normal[:, None] * towards).sum(-1, keepdims=True) * normal[:, None] - towards
    return (basis(normal) * clamped)[:, None, 1:], (basis(mirrored) * blurred)[..., 1:]


class _Normals:
    """Normal equations of 8 harmonics and 3 V gains, summed over groups of points."""

    def __init__(self, views: int, settings: EvidenceSettings) -> None:
        size = _FREE + 3 * views
        light = settings.light_error * np.sqrt(4 * np.pi / _FREE)  # harmonics of mean square 1 / (4 pi)
        spread = np.concatenate([np.full(_FREE, light), np.full(3 * views, settings.gain_error)])
        self._matrix, self._right = np.diag(1 / np.maximum(spread, 1e-6) ** 2), np.zeros(size)
        self._views, self._settings = views, settings

    def add(
        self, seen: Observations, of: Responses, columns: tuple[Float, Float], at: tuple[int, float], weight: float
    ) -> None:
        """Adds points whose candidate is the same; `weight` is that of each."""
        r, metallic = at
        base = best_base_color(seen, of, self._settings, r, metallic)
        slope, offset = linear_form(of, base, r, metallic)
        expected = base[:, None] * slope + offset
        diffuse = (1 - metallic) * base[:, None] * of.diffuse[:, :, r]
        error = (seen.radiance - expected) / seen.sigma
        nu = self._settings.freedom
        w = weight * seen.valid[..., None] * (nu + 1) / (nu + error**2) / seen.sigma.astype(float) ** 2
        for k in range(3):
            by_light = diffuse[..., k, None] * columns[0] + (expected - diffuse)[..., k, None] * columns[1]
            by_gain = expected[..., k, None] * np.eye(self._views)
            design = np.concatenate([by_light, by_gain], axis=-1)
            self._add_channel(k, design, seen.radiance[..., k] - expected[..., k], (w[..., k], slope[..., k]))

    def _add_channel(self, k: int, design: Float, error: Float, weighted: tuple[Float, Float]) -> None:
        """One channel, its base colours projected out."""
        w, slope = weighted
        norm = np.maximum((w * slope**2).sum(axis=1), LEAST_SQUARE)
        design = design - slope[..., None] * (np.einsum("pv,pv,pvj->pj", w, slope, design) / norm[:, None])[:, None]
        error = error - slope * ((w * slope * error).sum(axis=1) / norm)[:, None]
        gains = _FREE + k * self._views + np.arange(self._views)
        place = np.concatenate([np.arange(_FREE), gains])
        self._matrix[np.ix_(place, place)] += np.einsum("pv,pvi,pvj->ij", w, design, design)
        self._right[place] += np.einsum("pv,pvi,pv->i", w, design, error)

    def solved(self) -> Nuisances:
        """The corrections of largest probability."""
        found = np.linalg.solve(self._matrix, self._right).round(_DIGITS)
        gain = np.exp(found[_FREE:]).reshape(3, self._views).T
        return Nuisances(gain, np.concatenate([[0.0], found[:_FREE]]))
