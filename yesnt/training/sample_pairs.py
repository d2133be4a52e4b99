"""Pairs of samples for the energy score: the denoiser applied to fresh noise at random diffusion times."""

from __future__ import annotations

import numpy as np
import torch

from yesnt.decompose.network import Denoiser, noised
from yesnt.decompose.noise_planes import member_noise
from yesnt.decompose.weights import SMOOTH_SIGMAS


class SamplePairs:
    """Draws pairs of samples; all randomness is keyed by seed and training step.

    Args:
        seed: seed of all noise.
        patch: side P of a patch in pixels.
    """

    def __init__(self, seed: int, patch: int) -> None:
        self._seed = seed
        self._fields = _noise_fields(seed, patch)

    def draw(
        self, denoiser: Denoiser, condition: torch.Tensor, clean: torch.Tensor, step: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Draws two independent samples per patch, each from its own noise at the patch's random diffusion time.

        Args:
            denoiser: network that draws.
            condition: [B, C, P/2, P/2] condition of the denoiser.
            clean: [B, 2, P, P] ground truth in [-1, 1].
            step: training step.

        Returns:
            Two tensors [B, 2, P, P].
        """
        generator = torch.Generator().manual_seed(self._seed * 1_000_003 + step)
        rows = len(clean)
        # Half of the rows start from pure noise, which is what the first sampling step does.
        times = torch.rand(rows, generator=generator).mul(0.9).add(0.05)
        times[: rows // 2] = 1.0
        times = times[torch.randperm(rows, generator=generator)]
        state = noised(clean, torch.randn(clean.shape, generator=generator), times)
        # Pure-noise rows get fresh noise in both draws: there the state is nothing but a source of chance.
        fresh = torch.randn(clean.shape, generator=generator)
        other = torch.where((times == 1)[:, None, None, None], fresh, state)
        smooth = self._smooth(generator, 2 * rows, clean.shape[-1])
        drawn = denoiser(
            torch.cat([state, other]), smooth, torch.cat([condition, condition]), torch.cat([times, times])
        )
        first, second = drawn.chunk(2)
        return first, second

    def _smooth(self, generator: torch.Generator, rows: int, patch: int) -> torch.Tensor:
        """Crops of the stored fields; the two samples of a patch use different fields."""
        fields = torch.randperm(len(self._fields), generator=generator)[:rows].tolist()
        places = torch.randint(0, self._fields.shape[-1] - patch, (rows, 2), generator=generator).tolist()
        return torch.stack(
            [self._fields[f, :, y : y + patch, x : x + patch] for f, (y, x) in zip(fields, places, strict=True)]
        )


def _noise_fields(seed: int, patch: int, count: int = 96) -> torch.Tensor:
    """[count, smooth planes, 2P, 2P] noise fields made in advance.

    Blurring new fields at every step would cost more than the network.
    """
    side = 2 * patch
    return torch.from_numpy(np.stack([member_noise((seed, -1, k), side, side, SMOOTH_SIGMAS) for k in range(count)]))
