"""The backend that ships with the package: a small conditional diffusion model, one or two steps a draw."""

from __future__ import annotations

from pathlib import Path

import torch
from torch.nn import functional

from yesnt.decompose.auxiliary import AUXILIARY_INPUT_SIDE, fuse_predictions, upsample
from yesnt.decompose.backend import Licence
from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.latents import default_device
from yesnt.decompose.network import at_patch, noised
from yesnt.decompose.threads import one_thread
from yesnt.decompose.weights import SHIPPED, SMOOTH_SIGMAS, file_digest, load_weights

PRIOR_ROUGHNESS = 0.564
"""Mean roughness of the painted classes by their frequency (`training/synthetic/materials.py`)."""

SHRINKAGE_FACTOR = 0.9
"""How far the expected roughness may leave the prior's mean, as a share of how far estimator and second opinion would go.

Real shots are another world than the training's pictures: there they go too far. Chosen so that both the embedded shot
and the stage's objects gain (`tests/benchmarks/decompose_auxiliary.py`); metal is told well enough to be left alone.
"""


class EmbeddedBackend:
    """Few-step sampler with the package's own weights.

    Args:
        path: weights; the shipped ones by default.
        steps: sampling steps, 1 .. 4; step i starts at time 1 - i / steps.
        device: where the network lies; CUDA where there is one by default.
    """

    name = "embedded"
    licence = Licence("Apache-2.0", commercial=True)
    batch = 8
    align = 16

    def __init__(self, path: Path = SHIPPED, steps: int = 2, device: str | None = None) -> None:
        if not 1 <= steps <= 4:
            raise ValueError(f"steps {steps} must be 1 .. 4")
        network, self.patch = load_weights(path)
        self._device = device or default_device()
        self._network = network.to(self._device)
        self.weights_digest = file_digest(path)
        self.nfe = steps
        self.auxiliary_side = AUXILIARY_INPUT_SIDE if self._network.auxiliary else 0
        self.noise_sigmas = (0.0, 0.0, *SMOOTH_SIGMAS) * steps

    @one_thread()
    @torch.no_grad()
    def encode(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """[8, 3, P, P] and [8, 1, P, P] to [8, C, P/2, P/2]."""
        place = context.location.to(self._device)
        told = ContextBatch(context.image.to(self._device), place)
        condition = self._network.estimator(rgb.to(self._device), matte.to(self._device), told)
        if self._network.auxiliary is None:
            return condition
        if context.auxiliary is None:  # who was shown no whole subject agrees with the estimator
            return fuse_predictions(condition, condition[:, :2])
        return fuse_predictions(condition, at_patch(context.auxiliary.to(self._device), place, condition.shape[-1]))

    @one_thread()
    @torch.no_grad()
    def predict_auxiliary(self, picture: torch.Tensor) -> torch.Tensor:
        """[1, 4, S, S] of the whole subject to the second opinion [1, 2, S/4, S/4]."""
        if self._network.auxiliary is None:
            raise ValueError("these weights hold no second opinion (`auxiliary_side` is 0)")
        return self._network.auxiliary(picture.to(self._device))

    @one_thread()
    @torch.no_grad()
    def predict_mean(self, condition: torch.Tensor) -> torch.Tensor:
        """What estimator and second opinion expect, the mean of all draws by training, roughness drawn to the prior."""
        mean = self._read(condition)
        return torch.cat([mean[:, :1] - _shrinkage(mean), mean[:, 1:]], 1)

    @staticmethod
    def _read(condition: torch.Tensor) -> torch.Tensor:
        return 0.5 + 0.5 * upsample(condition[:, :2], 2 * condition.shape[-1]).clamp(-1, 1)

    @one_thread()
    @torch.no_grad()
    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Denoises from pure noise; between steps the draw is noised again with fresh planes."""
        steps, clean = self.nfe, torch.zeros(())
        for i, planes in enumerate(noise.to(self._device).chunk(steps, 1)):
            time = torch.full((len(noise),), 1 - i / steps, device=self._device)
            state = planes[:, :2] if i == 0 else noised(clean, planes[:, :2], time)
            clean = self._network.denoiser(state, planes[:, 2:], condition, time).clamp(-1, 1)
        # Estimator and auxiliary speak at half the resolution; what is finer in a draw is the pixel shuffle's pattern.
        drawn = upsample(0.5 + 0.5 * functional.avg_pool2d(clean, 2), clean.shape[-1])
        roughness = (drawn[:, :1] - _shrinkage(self._read(condition))).clamp(0, 1)  # draws keep their spread
        return torch.cat([roughness, drawn[:, 1:]], 1)


def _shrinkage(mean: torch.Tensor) -> torch.Tensor:
    """What is taken off the expected roughness [B, 1, P, P] of a mean [B, 2, P, P]."""
    return (1 - SHRINKAGE_FACTOR) * (mean[:, :1] - PRIOR_ROUGHNESS)
