"""Pairs of draws that the denoiser is trained with: fresh noise at a random time, keyed by the step."""

from __future__ import annotations

import numpy as np
import torch

from yesnt.decompose.network import Denoiser, noised
from yesnt.decompose.noise_planes import member_noise
from yesnt.decompose.weights import SMOOTH_SIGMAS


class SamplePairs:
    """Source of draws.

    Args:
        seed: of all noise.
        patch: side of a patch P.
    """

    def __init__(self, seed: int, patch: int) -> None:
        self._seed = seed
        self._noise = _noise_pool(seed, patch)

    def pair(
        self, denoiser: Denoiser, condition: torch.Tensor, clean: torch.Tensor, step: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Two independent draws for every patch, each from its own noise at the patch's random time.

        Args:
            denoiser: who draws.
            condition: [B, C, P/2, P/2].
            clean: [B, 2, P, P] truth in [-1, 1].
            step: of the training; with the seed it decides all noise.
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
        """Crops of ready noise fields, of different fields for the two draws of one patch."""
        fields = torch.randperm(len(self._noise), generator=generator)[:rows].tolist()
        places = torch.randint(0, self._noise.shape[-1] - patch, (rows, 2), generator=generator).tolist()
        return torch.stack(
            [self._noise[f, :, y : y + patch, x : x + patch] for f, (y, x) in zip(fields, places, strict=True)]
        )


def _noise_pool(seed: int, patch: int, count: int = 96) -> torch.Tensor:
    """[count, smooth planes, side, side] ready fields: blurring anew at every step would cost more than the network."""
    side = 2 * patch
    return torch.from_numpy(np.stack([member_noise((seed, -1, k), side, side, SMOOTH_SIGMAS) for k in range(count)]))
