"""Backend of the model in the package: a small conditional diffusion model that samples in one to four steps."""

from __future__ import annotations

from pathlib import Path

import torch
from torch.nn import functional

from yesnt.decompose.auxiliary import AUXILIARY_INPUT_SIDE, fuse_predictions, upsample
from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.latents import default_device
from yesnt.decompose.network import noised, sample_at_patch
from yesnt.decompose.registry import EMBEDDED_WEIGHTS
from yesnt.decompose.threads import one_thread
from yesnt.decompose.weights import SMOOTH_SIGMAS, load_weights

PRIOR_ROUGHNESS = 0.564
"""Mean roughness of the synthetic material classes, weighted by their frequency
(`yesnt.training.synthetic.materials.PRIOR`).
"""

SHRINKAGE_FACTOR = 0.9
"""Factor of the shrinkage of roughness: prediction = prior + factor (prediction - prior).

On real images, which differ from the training images, predicted roughness deviates too far from the mean of the prior.
The value lowers the error both on the embedded shot and on the objects of the capture stage
(`tests/benchmarks/decompose_auxiliary.py`). Metallic is not shrunk, because its detection is accurate.
"""


class EmbeddedBackend:
    """Few-step sampler. It follows `Backend`, `MeanPredictor` and `GlobalPredictor`.

    Args:
        path: weights that `save_weights` wrote.
        steps: sampling steps, 1 .. 4; step i starts at diffusion time 1 - i / steps.
        device: torch device of the network; None: CUDA if there is one.

    Raises:
        ValueError: steps is out of range.
        JobError: there are no weights, or they have another format.
        CorruptError: the weights cannot be read.
    """

    batch = 8
    align = 16

    def __init__(self, path: Path = EMBEDDED_WEIGHTS, steps: int = 1, device: str | None = None) -> None:
        if not 1 <= steps <= 4:
            raise ValueError(f"steps {steps} must be 1 .. 4")
        network, self.patch = load_weights(path)
        self._device = device or default_device()
        self._network = network.to(self._device)
        self.nfe = steps
        self.auxiliary_side = AUXILIARY_INPUT_SIDE if self._network.auxiliary else 0
        self.noise_sigmas = (0.0, 0.0, *SMOOTH_SIGMAS) * steps

    @one_thread()
    @torch.no_grad()
    def encode(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """Computes the condition [8, C, P/2, P/2]; arguments as in `Backend.encode`."""
        location = context.location.to(self._device)
        placed = ContextBatch(context.image.to(self._device), location)
        condition = self._network.estimator(rgb.to(self._device), matte.to(self._device), placed)
        if self._network.auxiliary is None:
            return condition
        if context.auxiliary is None:  # without an auxiliary prediction the difference is 0
            return fuse_predictions(condition, condition[:, :2])
        return fuse_predictions(
            condition, sample_at_patch(context.auxiliary.to(self._device), location, condition.shape[-1])
        )

    @one_thread()
    @torch.no_grad()
    def predict_auxiliary(self, image: torch.Tensor) -> torch.Tensor:
        """Predicts materials [1, 2, S/4, S/4] in [-1, 1] from the image [1, 4, S, S] of the whole subject.

        Raises:
            ValueError: these weights hold no auxiliary predictor.
        """
        if self._network.auxiliary is None:
            raise ValueError("these weights hold no auxiliary predictor (`auxiliary_side` is 0)")
        return self._network.auxiliary(image.to(self._device))

    @one_thread()
    @torch.no_grad()
    def predict_mean(self, condition: torch.Tensor) -> torch.Tensor:
        """Returns the mean of estimator and auxiliary predictor, [8, 2, P, P] in [0, 1], roughness shrunk to the prior.

        Training makes it the mean of the samples.
        """
        mean = _unshrunk_mean(condition)
        return torch.cat([mean[:, :1] - _shrinkage(mean), mean[:, 1:]], 1)

    @one_thread()
    @torch.no_grad()
    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Draws one member per row, [8, 2, P, P] in [0, 1], starting from pure noise.

        Between steps the sample is noised again with fresh noise planes.
        """
        steps, clean = self.nfe, torch.zeros(())
        for i, planes in enumerate(noise.to(self._device).chunk(steps, 1)):
            time = torch.full((len(noise),), 1 - i / steps, device=self._device)
            state = planes[:, :2] if i == 0 else noised(clean, planes[:, :2], time)
            clean = self._network.denoiser(state, planes[:, 2:], condition, time).clamp(-1, 1)
        # The conditions have half the resolution; finer detail in a sample is only the pattern of the pixel shuffle.
        drawn = upsample(0.5 + 0.5 * functional.avg_pool2d(clean, 2), clean.shape[-1])
        roughness = (drawn[:, :1] - _shrinkage(_unshrunk_mean(condition))).clamp(
            0, 1
        )  # a shift keeps the spread of the samples
        return torch.cat([roughness, drawn[:, 1:]], 1)


def _unshrunk_mean(condition: torch.Tensor) -> torch.Tensor:
    """Mean of both predictions, [B, 2, P, P] in [0, 1], before the shrinkage."""
    return 0.5 + 0.5 * upsample(condition[:, :2], 2 * condition.shape[-1]).clamp(-1, 1)


def _shrinkage(mean: torch.Tensor) -> torch.Tensor:
    """Amount [B, 1, P, P] that the shrinkage subtracts from the roughness of a mean [B, 2, P, P]."""
    return (1 - SHRINKAGE_FACTOR) * (mean[:, :1] - PRIOR_ROUGHNESS)
