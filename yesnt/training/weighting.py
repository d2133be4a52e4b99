"""Trains the denoiser on the difference of estimator and auxiliary predictor: samples have to spread where they differ.

Both predictors stay frozen. The images show subjects that are held out from the perceptron, since on its training
subjects its error is smaller than on new images.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from yesnt.decompose.auxiliary import AUXILIARY_INPUT_SIDE, AuxiliaryPredictor, fuse_predictions
from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.network import Network, sample_at_patch
from yesnt.decompose.weights import PATCH, channels_last, save_weights
from yesnt.training.checkpoint import read_state, write_state
from yesnt.training.image_archive import open_views
from yesnt.training.losses import energy_score
from yesnt.training.sample_pairs import SamplePairs
from yesnt.training.synthetic.dataset import Patches, crop, recolour_garments
from yesnt.training.synthetic.materials import class_weights
from yesnt.training.trainer import draw_shrink, rate_schedule

_COLOUR_MIXING, _RECOLOURED = 0.2, 0.2
"""Probabilities of the colour augmentations, between those of the main phase and of fine-tuning."""


@dataclass(frozen=True)
class WeightingSettings:
    """Everything that determines the further training of the denoiser.

    Attributes:
        seed: seed of data and noise.
        steps: training steps.
        batch: patches per step.
        patch: side of a patch in pixels.
        rate: highest learning rate.
        ema: decay of the exponential moving average of the weights.
    """

    seed: int = 0
    steps: int = 1000
    batch: int = 8
    patch: int = PATCH
    rate: float = 1e-3
    ema: float = 0.99


def with_auxiliary(network: Network, auxiliary: AuxiliaryPredictor) -> Network:
    """Joins a network and an auxiliary predictor.

    The new input channels of the denoiser have weight 0, so its samples only change by the averaged mean.

    Args:
        network: network without an auxiliary predictor.
        auxiliary: trained predictor.

    Returns:
        The joined network in evaluation mode, without gradients.
    """
    widths = (auxiliary.hidden.in_channels, auxiliary.hidden.out_channels)
    joined = Network(replace(network.shape, auxiliary=widths))
    joined.estimator, joined.auxiliary = network.estimator, auxiliary
    state = network.denoiser.state_dict()
    stem = joined.denoiser.stem.weight.new_zeros(joined.denoiser.stem.weight.shape)
    stem[:, : state["stem.weight"].shape[1]] = state["stem.weight"]
    joined.denoiser.load_state_dict({**state, "stem.weight": stem})
    return channels_last(joined.eval().requires_grad_(False))


class WeightingTrainer:
    """Network, averaged denoiser and optimiser at a training step.

    Args:
        settings: data and rates.
        network: what `with_auxiliary` returned.
        paths: archive files of the held-out subjects.

    Raises:
        ValueError: the network has no auxiliary predictor.
    """

    def __init__(self, settings: WeightingSettings, network: Network, paths: Sequence[Path]) -> None:
        if network.auxiliary is None:
            raise ValueError("the network has no auxiliary predictor whose weighting could be trained")
        self.settings, self.network, self._paths, self._auxiliary = settings, network, paths, network.auxiliary
        self.averaged = {name: value.clone() for name, value in network.denoiser.state_dict().items()}
        network.denoiser.requires_grad_(True)
        self.optimiser = torch.optim.AdamW(network.denoiser.parameters(), lr=settings.rate, weight_decay=0.02)
        self._samples = SamplePairs(settings.seed, settings.patch)
        self.step = 0

    def advance(self) -> float:
        """Runs one training step and returns its loss."""
        rgb, matte, truth, kind, context, location, _, _, auxiliary_input = (
            torch.from_numpy(np.ascontiguousarray(plane)) for plane in self._patches().planes()
        )
        clean = 2 * truth - 1
        with torch.no_grad():
            condition = self.network.estimator(rgb, matte, ContextBatch(context, location))
            auxiliary = torch.cat([self._auxiliary(image[None]) for image in auxiliary_input])
            condition = fuse_predictions(condition, sample_at_patch(auxiliary, location, condition.shape[-1]))
        weights = matte * torch.from_numpy(class_weights())[kind.clamp_min(0)][:, None]
        samples = self._samples.draw(self.network.denoiser, condition, clean, self.step)
        loss = energy_score(*samples, clean, weights)
        self.optimiser.param_groups[0]["lr"] = self.settings.rate * rate_schedule(self.step, self.settings.steps)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.denoiser.parameters(), 1.0)
        self.optimiser.step()
        self.step += 1
        for name, value in self.network.denoiser.state_dict().items():
            self.averaged[name].lerp_(value, 1 - min(self.settings.ema, (1 + self.step) / (10 + self.step)))
        return float(loss.detach())

    def save(self, path: Path) -> None:
        """Writes a checkpoint atomically."""
        state = {
            "step": self.step,
            "denoiser": self.network.denoiser.state_dict(),
            "averaged": self.averaged,
            "optimiser": self.optimiser.state_dict(),
        }
        write_state(path, state)

    def resume(self, path: Path) -> None:
        """Restores the state of a checkpoint.

        Raises:
            JobError: the file has another format.
        """
        state = read_state(path)
        self.network.denoiser.load_state_dict(state["denoiser"])
        self.averaged = state["averaged"]
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]

    def result(self) -> Network:
        """Returns the network with the averaged denoiser."""
        network = Network(self.network.shape)
        network.load_state_dict(self.network.state_dict())
        network.denoiser.load_state_dict(self.averaged)
        return network.eval().requires_grad_(False)

    def _patches(self) -> Patches:
        s = self.settings
        rng = np.random.Generator(np.random.Philox(key=[s.seed, 2_000_000_000 + self.step]))
        return Patches.stack([self._example(rng) for _ in range(s.batch)])

    def _example(self, rng: np.random.Generator) -> Patches:
        views = open_views(self._paths[int(rng.integers(len(self._paths)))])
        image = views[int(rng.integers(len(views)))]
        if rng.random() < _RECOLOURED:
            image = recolour_garments(rng, image)
        return crop(rng, image, self.settings.patch, draw_shrink(rng), _COLOUR_MIXING, AUXILIARY_INPUT_SIDE)


def train_weighting(trainer: WeightingTrainer, folder: Path, every: int = 50) -> Iterator[tuple[int, float]]:
    """Runs to the last step, and saves a checkpoint and weights every `every` steps.

    Args:
        trainer: state of the training.
        folder: folder of checkpoint and weights.
        every: steps from one checkpoint to the next.

    Yields:
        (step, mean loss since the checkpoint before).
    """
    losses: list[float] = []
    while trainer.step < trainer.settings.steps:
        losses.append(trainer.advance())
        if trainer.step % every == 0 or trainer.step == trainer.settings.steps:
            trainer.save(folder / "weighting.pt")
            save_weights(trainer.result(), folder / "embedded.safetensors", trainer.settings.patch)
            yield trainer.step, float(np.mean(losses))
            losses.clear()
