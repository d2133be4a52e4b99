"""The likelihood of fit.py on any torch device, equal to rounding; for machines with CUDA."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.reference import LEAST_SQUARE
from yesnt.decompose.evidence.settings import DARKEST_METAL, METAL_LUMINANCE, EvidenceSettings, metallic_levels

if TYPE_CHECKING:
    import torch

F32 = NDArray[np.float32]

_VALUES = 1 << 21  # per tile of points, views, channels and candidates: about ten temporaries of 16 MB each
_MOST_ERROR = 1e4  # standard deviations, as in fit.py


def negative_log_likelihood_torch(
    seen: Observations, of: Responses, settings: EvidenceSettings, device: str | None = None
) -> F32:
    """As `fit.negative_log_likelihood`, to rounding: [P, R, M] float32.

    Args:
        seen: what V cameras saw of P points.
        of: responses for R levels of roughness.
        settings: of the evidence.
        device: name of a torch device; None: CUDA if there is one, else the CPU.
    """
    import torch

    where = device or ("cuda" if torch.cuda.is_available() else "cpu")
    metallic = metallic_levels(settings)
    count, views = seen.valid.shape
    out = np.zeros((count, len(of.average), len(metallic)), dtype=np.float32)
    step = max(1, _VALUES // max(3 * views * len(metallic), 1))
    levels = torch.from_numpy(metallic).to(where)
    for first in range(0, count, step):
        part = slice(first, first + step)
        tile = _Tile.of(Observations(seen.radiance[part], seen.sigma[part], seen.valid[part]), settings, where)
        for r in range(len(of.average)):
            lobes = _Lobes.of(of, part, r, levels)
            out[part, r] = tile.cost(lobes).cpu().numpy()
    return out


def _on(array: NDArray[np.generic], device: torch.device | str) -> torch.Tensor:
    import torch

    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float64)).to(device)


@dataclass(frozen=True)
class _Lobes:
    """Responses of N points at one roughness; diffuse to f90 are [N, V, 3, 1], missing [N, V, 1, 1]."""

    diffuse: torch.Tensor
    dielectric: torch.Tensor
    f0: torch.Tensor
    f90: torch.Tensor
    missing: torch.Tensor
    average: float
    metallic: torch.Tensor

    @classmethod
    def of(cls, of: Responses, part: slice, r: int, metallic: torch.Tensor) -> _Lobes:
        """Of some points at level r."""
        lobes = (of.diffuse, of.dielectric, of.metal_f0, of.metal_f90)
        diffuse, dielectric, f0, f90 = (_on(a[part, :, r], metallic.device)[..., None] for a in lobes)
        missing = _on(of.missing[part, :, r], metallic.device)[..., None, None]
        return cls(diffuse, dielectric, f0, f90, missing, float(of.average[r]), metallic)

    def linear_form(self, base: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """A and D [N, V, 3, M] at the base colour [N, 3, M] (reference.linear_form)."""
        single = base + (1 - base) / 21
        scattered = single * self.average / (1 - single * (1 - self.average))
        metal = self.metallic * (1 + scattered[:, None] * self.missing)
        rest = 1 - self.metallic
        return rest * self.diffuse + metal * self.f0, rest * self.dielectric + metal * self.f90


@dataclass(frozen=True)
class _Tile:
    """What V cameras saw of N points: radiance and 1 / sigma [N, V, 3, 1], valid [N, V, 1, 1] as 0 and 1."""

    radiance: torch.Tensor
    inverse: torch.Tensor
    valid: torch.Tensor
    settings: EvidenceSettings

    @classmethod
    def of(cls, seen: Observations, settings: EvidenceSettings, device: str) -> _Tile:
        """Of some points."""
        return cls(
            _on(seen.radiance, device)[..., None], 1 / _on(seen.sigma, device)[..., None],
            _on(seen.valid, device)[..., None, None], settings,
        )  # fmt: skip

    def cost(self, lobes: _Lobes) -> torch.Tensor:
        """Minus the log likelihood [N, M] at one roughness."""
        import torch

        nu, base = self.settings.freedom, self._best_base_color(lobes)
        cost = 0.5 * (nu + 1) * torch.log1p(self._residual(lobes, base) ** 2 / nu)
        known = self.valid.amax(dim=(1, 2, 3))
        luminance = (base * base.new_tensor(LUMINANCE_REC709)[:, None]).sum(1)
        prior = self.settings.temper * _darkness(lobes.metallic, luminance)
        return (cost * self.valid).sum((1, 2)) + prior * known[:, None]

    def _best_base_color(self, lobes: _Lobes) -> torch.Tensor:
        """Base colour [N, 3, M] (reference.best_base_color)."""
        nu, count = self.settings.freedom, len(lobes.metallic)
        base = self.radiance.new_full((len(self.radiance), 3, count), 0.5)
        weight = self.valid
        for _ in range(self.settings.steps):
            slope, offset = lobes.linear_form(base)
            w = weight * self.valid * self.inverse**2 * slope
            up, down = (w * (self.radiance - offset)).sum(1), (w * slope).sum(1)
            base = (up / down.clamp(min=LEAST_SQUARE)).clamp(0, 1)
            weight = (nu + 1) / (nu + self._residual(lobes, base) ** 2)
        return base

    def _residual(self, lobes: _Lobes, base: torch.Tensor) -> torch.Tensor:
        """Residuals [N, V, 3, M] in standard deviations."""
        slope, offset = lobes.linear_form(base)
        return ((self.radiance - offset - base[:, None] * slope) * self.inverse).clamp(-_MOST_ERROR, _MOST_ERROR)


def _darkness(metallic: torch.Tensor, luminance: torch.Tensor) -> torch.Tensor:
    """What a dark base colour of luminance [N, M] tells against a metal (reference.darkness)."""
    import torch

    median, deviation = METAL_LUMINANCE
    apart = torch.log(luminance.clamp(min=LEAST_SQUARE) / median) / deviation
    told = metallic * (0.5 * apart**2).clamp(max=DARKEST_METAL)
    return torch.where(luminance < median, told, torch.zeros_like(told))
