"""Trains the perceptron of the second opinion on kept features of the backbone, which itself is left as published."""

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
    """What determines the perceptron.

    Attributes:
        seed: of its first weights and of the order of examples.
        people: people of the archive that it learns from or is judged on, at most.
        objects: objects of the archive, likewise.
        widths: of its hidden layers.
        steps: of training.
        batch: places per step.
        rate: highest learning rate.
        dropout: share of the first layer that is silenced in a step.
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
    """Standardised features to roughness, metallic (-1 .. 1 for 0 .. 1) and classes; those are for training only."""

    def __init__(self, settings: AuxiliarySettings, places: FeatureSamples) -> None:
        super().__init__()
        sample = torch.from_numpy(places.features[:: max(1, len(places.features) // 100_000)]).float()
        self.mean, self.spread = sample.mean(0), sample.std(0).clamp_min(1e-3)
        first, second = settings.widths
        self.first = nn.Linear(sample.shape[1], first)
        self.second = nn.Linear(first, second)
        self.last = nn.Linear(second, 2 + len(CLASSES))
        self.dropout = nn.Dropout(settings.dropout)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """[n, C] to [n, 2 + classes]."""
        x = self.dropout(torch.relu(self.first((features - self.mean) / self.spread)))
        return self.last(torch.relu(self.second(x)))

    def auxiliary(self, backbone: Backbone) -> AuxiliaryPredictor:
        """As part of the network: features are standardised by the first layer's weights."""
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
    folder: Path, settings: AuxiliarySettings, learnt: Sequence[Path], kept: Sequence[Path]
) -> AuxiliaryPredictor:
    """The second opinion, from the folder if it is there.

    Args:
        folder: of the training; `auxiliary.safetensors` is written to it.
        settings: of the perceptron.
        learnt: files of the archive that it learns from.
        kept: files that it is only judged on.
    """
    path = folder / "auxiliary.safetensors"
    if not path.exists():
        backbone = published_backbone()
        told, judged = (open_samples([*extract_all(folder, settings.seed, p, backbone)]) for p in (learnt, kept))
        log.info("%d places to learn from, %d to judge by", len(told.kind), len(judged.kind))
        perceptron = train_perceptron(settings, told)
        log.info("auxiliary: error of roughness and metallic %s where it has learnt, %s elsewhere",
                 errors(perceptron, told), errors(perceptron, judged))  # fmt: skip
        part = path.with_suffix(".part")
        state = perceptron.auxiliary(backbone).state_dict()
        save_file({name: value.contiguous() for name, value in state.items()}, part)
        part.replace(path)
    auxiliary = AuxiliaryPredictor(*settings.widths)
    auxiliary.load_state_dict(load_file(path))
    return auxiliary.eval().requires_grad_(False)


@torch.no_grad()
def errors(perceptron: Perceptron, places: FeatureSamples) -> tuple[float, float]:
    """Root mean square error of roughness and metallic over at most 100,000 places, each in [0, 1]."""
    some = slice(None, None, max(1, len(places.kind) // 100_000))
    told = (perceptron(torch.from_numpy(places.features[some]).float())[:, :2].clamp(-1, 1) + 1) / 2
    roughness, metallic = (told - torch.from_numpy(places.truth[some]).float()).square().mean(0).sqrt().tolist()
    return round(roughness, 4), round(metallic, 4)


def train_perceptron(settings: AuxiliarySettings, places: FeatureSamples) -> Perceptron:
    """Trains anew: a few minutes, so nothing is kept in between."""
    torch.manual_seed(settings.seed)
    perceptron = Perceptron(settings, places)
    optimiser = torch.optim.AdamW(perceptron.parameters(), lr=settings.rate, weight_decay=0.05)
    rng = np.random.Generator(np.random.Philox(key=[settings.seed, 3_000_000_000]))
    for step in range(settings.steps):
        optimiser.param_groups[0]["lr"] = settings.rate * rate_schedule(step, settings.steps)
        loss = perceptron_loss(perceptron, places, rng.integers(0, len(places.kind), settings.batch))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    return perceptron.eval()


def perceptron_loss(perceptron: Perceptron, places: FeatureSamples, rows: NDArray[np.integer]) -> torch.Tensor:
    """The loss that the estimator's own picture of the whole has, at some places."""
    features, truth, kind = (torch.from_numpy(plane[rows]) for plane in places)
    scores = perceptron(features.float())[..., None, None]
    cover = torch.ones(len(rows), 1)
    told = torch.cat([truth.float(), cover], 1)[..., None, None]
    return context_loss(scores, told, kind.long()[:, None, None], torch.from_numpy(class_weights()))
