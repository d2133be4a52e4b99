"""The likelihood of fit.py on any torch device, equal to rounding; for machines with CUDA."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.reference import LEAST_SQUARE, MOST_TURN
from yesnt.decompose.evidence.settings import DARKEST_METAL, METAL_LUMINANCE, EvidenceSettings, metallic_levels

if TYPE_CHECKING:
    import torch

F32 = NDArray[np.float32]

_VALUES = 1 << 20  # per tile of points, views, channels and candidates: about twenty temporaries of 8 MB each
_MOST_ERROR = 1e4  # standard deviations, as in fit.py


def negative_log_likelihood_torch(
    seen: Observations,
    of: Responses,
    settings: EvidenceSettings,
    turned: tuple[Responses, Responses] | None = None,
    *,
    device: str | None = None,
) -> F32:
    """As `fit.negative_log_likelihood`, to rounding: [P, R, M] float32.

    Args:
        seen: what V cameras saw of P points.
        of: responses for R levels of roughness.
        settings: of the evidence.
        turned: responses at turned normals (reference.negative_log_likelihood).
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
            turns = [_Lobes.of(one, part, r, levels) for one in turned or ()]
            out[part, r] = tile.cost(lobes, turns).cpu().numpy()
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

    def cost(self, lobes: _Lobes, turns: list[_Lobes]) -> torch.Tensor:
        """Minus the log likelihood [N, M] at one roughness."""
        import torch

        nu, temper = self.settings.freedom, self.settings.temper
        base, turn, weight = self._fitted(lobes, turns)
        cost = 0.5 * (nu + 1) * torch.log1p(self._residual(lobes, turns, base, turn) ** 2 / nu)
        known = self.valid.amax(dim=(1, 2, 3))
        luminance = (base * base.new_tensor(LUMINANCE_REC709)[:, None]).sum(1)
        prior = _darkness(lobes.metallic, luminance)
        if turns:
            a, b, c, *_ = self._curvature(lobes, turns, base, weight)
            precision = (1 + a / temper) * (1 + c / temper) - (b / temper) ** 2
            prior = prior + 0.5 * sum(t * t for t in turn) + 0.5 * torch.log(precision)
        return (cost * self.valid).sum((1, 2)) + temper * prior * known[:, None]

    def _fitted(self, lobes: _Lobes, turns: list[_Lobes]) -> tuple[torch.Tensor, list[torch.Tensor], torch.Tensor]:
        """Base colour [N, 3, M], turns [N, M] about two axes and the last weights (reference.best_base_color)."""
        nu, count = self.settings.freedom, len(lobes.metallic)
        base = self.radiance.new_full((len(self.radiance), 3, count), 0.5)
        turn = [self.radiance.new_zeros((len(self.radiance), count)) for _ in turns]
        weight = self.valid
        for _ in range(self.settings.steps):
            slope, offset = _turned_form(lobes, turns, base, turn)
            w = weight * self.valid * self.inverse**2 * slope
            up, down = (w * (self.radiance - offset)).sum(1), (w * slope).sum(1)
            base = (up / down.clamp(min=LEAST_SQUARE)).clamp(0, 1)
            if turns:
                turn = self._best_turn(lobes, turns, base, weight)
            weight = (nu + 1) / (nu + self._residual(lobes, turns, base, turn) ** 2)
        return base, turn, weight

    def _best_turn(
        self, lobes: _Lobes, turns: list[_Lobes], base: torch.Tensor, weight: torch.Tensor
    ) -> list[torch.Tensor]:
        """Turn of largest probability [N, M] about two axes."""
        a, b, c, d, e = self._curvature(lobes, turns, base, weight)
        a, c = a + self.settings.temper, c + self.settings.temper
        norm = a * c - b * b
        return [one.clamp(-MOST_TURN, MOST_TURN) for one in ((c * d - b * e) / norm, (a * e - b * d) / norm)]

    def _curvature(
        self, lobes: _Lobes, turns: list[_Lobes], base: torch.Tensor, weight: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """J'WJ of the two turns (11, 12, 22) and J'We of the unturned error (1, 2), each [N, M]."""
        plain = _expected(lobes, base)
        first, second = (_expected(one, base) - plain for one in turns)
        error, w = self.radiance - plain, weight * self.valid * self.inverse**2
        pairs = (first, first), (first, second), (second, second), (first, error), (second, error)
        return tuple((w * one * other).sum((1, 2)) for one, other in pairs)

    def _residual(
        self, lobes: _Lobes, turns: list[_Lobes], base: torch.Tensor, turn: list[torch.Tensor]
    ) -> torch.Tensor:
        """Residuals [N, V, 3, M] in standard deviations."""
        slope, offset = _turned_form(lobes, turns, base, turn)
        return ((self.radiance - offset - base[:, None] * slope) * self.inverse).clamp(-_MOST_ERROR, _MOST_ERROR)


def _turned_form(
    lobes: _Lobes, turns: list[_Lobes], base: torch.Tensor, turn: list[torch.Tensor]
) -> tuple[torch.Tensor, torch.Tensor]:
    """A and D [N, V, 3, M] at a turned normal, linear in the turns."""
    plain = lobes.linear_form(base)
    slope, offset = plain
    for one, share in zip(turns, turn, strict=True):
        other = one.linear_form(base)
        slope = slope + share[:, None, None] * (other[0] - plain[0])
        offset = offset + share[:, None, None] * (other[1] - plain[1])
    return slope, offset


def _expected(lobes: _Lobes, base: torch.Tensor) -> torch.Tensor:
    """Radiance b A + D [N, V, 3, M]."""
    slope, offset = lobes.linear_form(base)
    return base[:, None] * slope + offset


def _darkness(metallic: torch.Tensor, luminance: torch.Tensor) -> torch.Tensor:
    """What a dark base colour of luminance [N, M] tells against a metal (reference.darkness)."""
    import torch

    median, deviation = METAL_LUMINANCE
    apart = torch.log(luminance.clamp(min=LEAST_SQUARE) / median) / deviation
    told = metallic * (0.5 * apart**2).clamp(max=DARKEST_METAL)
    return torch.where(luminance < median, told, torch.zeros_like(told))
