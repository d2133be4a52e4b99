"""Trains the perceptron of the auxiliary predictor on stored features of the backbone, which stays frozen."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from torch import nn

from yesnt.decompose.auxiliary import AuxiliaryPredictor
from yesnt.decompose.backbone import FEATURE_CHANNELS, Backbone
from yesnt.training.feature_archive import FeatureSamples, extract_all, open_samples
from yesnt.training.losses import context_loss
from yesnt.training.published_backbone import published_backbone
from yesnt.training.synthetic.materials import CLASSES, class_weights
from yesnt.training.trainer import rate_schedule

log = logging.getLogger("yesnt.train")


@dataclass(frozen=True)
class AuxiliarySettings:
    """Everything that determines the perceptron.

    Attributes:
        seed: seed of the initial weights and of the order of samples.
        people: most people of the archive for training and validation.
        objects: most procedural objects of the archive for training and validation.
        widths: channels of the two hidden layers.
        steps: training steps.
        batch: samples per step.
        rate: highest learning rate.
        dropout: dropout probability of the first hidden layer.
    """

    seed: int = 0
    people: int = 400
    objects: int = 300
    widths: tuple[int, int] = (192, 96)
    steps: int = 600
    batch: int = 2048
    rate: float = 1e-3
    dropout: float = 0.5


class Perceptron(nn.Module):
    """Perceptron on standardised features.

    It predicts roughness and metallic, scaled from [0, 1] to [-1, 1], and class scores, which serve training only.

    Args:
        settings: sizes and dropout.
        samples: training samples, from which mean and deviation of the features are taken.
    """

    def __init__(self, settings: AuxiliarySettings, samples: FeatureSamples) -> None:
        super().__init__()
        sample = torch.from_numpy(samples.features[:: max(1, len(samples.features) // 100_000)]).float()
        self.mean, self.spread = sample.mean(0), sample.std(0).clamp_min(1e-3)
        first, second = settings.widths
        self.first = nn.Linear(sample.shape[1], first)
        self.second = nn.Linear(first, second)
        self.last = nn.Linear(second, 2 + len(CLASSES))
        self.dropout = nn.Dropout(settings.dropout)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Features [n, C] to [n, 2 + classes]."""
        x = self.dropout(torch.relu(self.first((features - self.mean) / self.spread)))
        return self.last(torch.relu(self.second(x)))

    def predictor(self, backbone: Backbone) -> AuxiliaryPredictor:
        """Returns the predictor of the network, with the standardisation merged into the weights of the first layer.

        Args:
            backbone: backbone of the predictor.
        """
        auxiliary = AuxiliaryPredictor(self.first.out_features, self.second.out_features)
        auxiliary.backbone = backbone
        weight = self.first.weight.data / self.spread
        for level, part in zip(auxiliary.projections, torch.split(weight, list(FEATURE_CHANNELS), 1), strict=True):
            level.weight.data = part[:, :, None, None].clone()
        auxiliary.bias.data = self.first.bias.data - weight @ self.mean
        auxiliary.hidden.load_state_dict(_as_convolution(self.second, self.second.out_features))
        auxiliary.output.load_state_dict(_as_convolution(self.last, 2))
        return auxiliary.eval().requires_grad_(False)


def _as_convolution(linear: nn.Linear, rows: int) -> dict[str, torch.Tensor]:
    return {"weight": linear.weight.data[:rows, :, None, None].clone(), "bias": linear.bias.data[:rows].clone()}


def make_auxiliary(
    folder: Path, settings: AuxiliarySettings, training: Sequence[Path], held_out: Sequence[Path]
) -> AuxiliaryPredictor:
    """Trains the auxiliary predictor, or loads it from the folder if it is there.

    Args:
        folder: folder of the training; `auxiliary.safetensors` is written to it.
        settings: settings of the perceptron.
        training: archive files of the subjects to train on.
        held_out: archive files of other subjects, for validation only.

    Returns:
        The predictor in evaluation mode, without gradients.

    Raises:
        MissingPartError: the package with the published backbone is not installed.
        JobError: its file is another version.
    """
    path = folder / "auxiliary.safetensors"
    if not path.exists():
        backbone = published_backbone()
        learning, validation = (
            open_samples([*extract_all(folder, settings.seed, p, backbone)]) for p in (training, held_out)
        )
        log.info("%d training samples, %d validation samples", len(learning.kind), len(validation.kind))
        perceptron = train_perceptron(settings, learning)
        log.info("auxiliary predictor: RMSE of roughness and metallic %s on training, %s on validation samples",
                 errors(perceptron, learning), errors(perceptron, validation))  # fmt: skip
        part = path.with_suffix(".part")
        state = perceptron.predictor(backbone).state_dict()
        save_file({name: value.contiguous() for name, value in state.items()}, part)
        part.replace(path)
    auxiliary = AuxiliaryPredictor(*settings.widths)
    auxiliary.load_state_dict(load_file(path))
    return auxiliary.eval().requires_grad_(False)


@torch.no_grad()
def errors(perceptron: Perceptron, samples: FeatureSamples) -> tuple[float, float]:
    """Returns the RMSE of roughness and metallic, in units of [0, 1], over at most 100,000 samples."""
    some = slice(None, None, max(1, len(samples.kind) // 100_000))
    predicted = (perceptron(torch.from_numpy(samples.features[some]).float())[:, :2].clamp(-1, 1) + 1) / 2
    roughness, metallic = (predicted - torch.from_numpy(samples.truth[some]).float()).square().mean(0).sqrt().tolist()
    return round(roughness, 4), round(metallic, 4)


def train_perceptron(settings: AuxiliarySettings, samples: FeatureSamples) -> Perceptron:
    """Trains a perceptron from scratch. It takes minutes, so there are no checkpoints."""
    torch.manual_seed(settings.seed)
    perceptron = Perceptron(settings, samples)
    optimiser = torch.optim.AdamW(perceptron.parameters(), lr=settings.rate, weight_decay=0.05)
    rng = np.random.Generator(np.random.Philox(key=[settings.seed, 3_000_000_000]))
    for step in range(settings.steps):
        optimiser.param_groups[0]["lr"] = settings.rate * rate_schedule(step, settings.steps)
        loss = perceptron_loss(perceptron, samples, rng.integers(0, len(samples.kind), settings.batch))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    return perceptron.eval()


def perceptron_loss(perceptron: Perceptron, samples: FeatureSamples, rows: NDArray[np.integer]) -> torch.Tensor:
    """Returns the loss of some samples, the same as that of the context head (`context_loss`).

    Args:
        perceptron: perceptron to evaluate.
        samples: all samples.
        rows: indices of the samples that count.
    """
    features, truth, kind = (torch.from_numpy(plane[rows]) for plane in samples)
    scores = perceptron(features.float())[..., None, None]
    cover = torch.ones(len(rows), 1)
    target = torch.cat([truth.float(), cover], 1)[..., None, None]
    return context_loss(scores, target, kind.long()[:, None, None], torch.from_numpy(class_weights()))
