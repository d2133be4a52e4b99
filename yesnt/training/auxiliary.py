"""Trains the perceptron of the second opinion on kept features of the trunk, which itself is left as published."""

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

from yesnt.decompose.auxiliary import Opinion
from yesnt.decompose.trunk import TOLD_CHANNELS, Trunk
from yesnt.training.feature_archive import Places, describe_all, open_places
from yesnt.training.losses import whole_loss
from yesnt.training.published_trunk import published_trunk
from yesnt.training.synthetic.materials import CLASSES, importance
from yesnt.training.trainer import course

log = logging.getLogger("yesnt.train")


@dataclass(frozen=True)
class OpinionSettings:
    """What determines the perceptron.

    Attributes:
        seed: of its first weights and of the order of examples.
        people: people of the archive that it learns from or is judged on, at most.
        things: things of the archive, likewise.
        widths: of its hidden layers.
        steps: of training.
        batch: places per step.
        rate: highest learning rate.
        dropout: share of the first layer that is silenced in a step.
    """

    seed: int = 0
    people: int = 400
    things: int = 300
    widths: tuple[int, int] = (192, 96)
    steps: int = 600
    batch: int = 2048
    rate: float = 1e-3
    dropout: float = 0.5


class Perceptron(nn.Module):
    """Standardised features to roughness, metallic (-1 .. 1 for 0 .. 1) and classes; those are for training only."""

    def __init__(self, settings: OpinionSettings, places: Places) -> None:
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

    def opinion(self, trunk: Trunk) -> Opinion:
        """As part of the network: features are standardised by the first layer's weights."""
        opinion = Opinion(self.first.out_features, self.second.out_features)
        opinion.trunk = trunk
        weight = self.first.weight.data / self.spread
        for level, part in zip(opinion.levels, torch.split(weight, list(TOLD_CHANNELS), 1), strict=True):
            level.weight.data = part[:, :, None, None].clone()
        opinion.bias.data = self.first.bias.data - weight @ self.mean
        opinion.hidden.load_state_dict(_as_convolution(self.second, self.second.out_features))
        opinion.last.load_state_dict(_as_convolution(self.last, 2))
        return opinion.eval().requires_grad_(False)


def _as_convolution(linear: nn.Linear, rows: int) -> dict[str, torch.Tensor]:
    return {"weight": linear.weight.data[:rows, :, None, None].clone(), "bias": linear.bias.data[:rows].clone()}


def make_opinion(folder: Path, settings: OpinionSettings, learnt: Sequence[Path], kept: Sequence[Path]) -> Opinion:
    """The second opinion, from the folder if it is there.

    Args:
        folder: of the training; `opinion.safetensors` is written to it.
        settings: of the perceptron.
        learnt: files of the archive that it learns from.
        kept: files that it is only judged on.
    """
    path = folder / "opinion.safetensors"
    if not path.exists():
        trunk = published_trunk()
        told, judged = (open_places([*describe_all(folder, settings.seed, p, trunk)]) for p in (learnt, kept))
        log.info("%d places to learn from, %d to judge by", len(told.kind), len(judged.kind))
        perceptron = train_perceptron(settings, told)
        log.info("opinion: error of roughness and metallic %s where it has learnt, %s elsewhere",
                 errors(perceptron, told), errors(perceptron, judged))  # fmt: skip
        part = path.with_suffix(".part")
        state = perceptron.opinion(trunk).state_dict()
        save_file({name: value.contiguous() for name, value in state.items()}, part)
        part.replace(path)
    opinion = Opinion(*settings.widths)
    opinion.load_state_dict(load_file(path))
    return opinion.eval().requires_grad_(False)


@torch.no_grad()
def errors(perceptron: Perceptron, places: Places) -> tuple[float, float]:
    """Root mean square error of roughness and metallic over at most 100,000 places, each in [0, 1]."""
    some = slice(None, None, max(1, len(places.kind) // 100_000))
    told = (perceptron(torch.from_numpy(places.features[some]).float())[:, :2].clamp(-1, 1) + 1) / 2
    roughness, metallic = (told - torch.from_numpy(places.truth[some]).float()).square().mean(0).sqrt().tolist()
    return round(roughness, 4), round(metallic, 4)


def train_perceptron(settings: OpinionSettings, places: Places) -> Perceptron:
    """Trains anew: a few minutes, so nothing is kept in between."""
    torch.manual_seed(settings.seed)
    perceptron = Perceptron(settings, places)
    optimiser = torch.optim.AdamW(perceptron.parameters(), lr=settings.rate, weight_decay=0.05)
    rng = np.random.Generator(np.random.Philox(key=[settings.seed, 3_000_000_000]))
    for step in range(settings.steps):
        optimiser.param_groups[0]["lr"] = settings.rate * course(step, settings.steps)
        loss = perceptron_loss(perceptron, places, rng.integers(0, len(places.kind), settings.batch))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    return perceptron.eval()


def perceptron_loss(perceptron: Perceptron, places: Places, rows: NDArray[np.integer]) -> torch.Tensor:
    """The loss that the reader's own picture of the whole has, at some places."""
    features, truth, kind = (torch.from_numpy(plane[rows]) for plane in places)
    scores = perceptron(features.float())[..., None, None]
    cover = torch.ones(len(rows), 1)
    told = torch.cat([truth.float(), cover], 1)[..., None, None]
    return whole_loss(scores, told, kind.long()[:, None, None], torch.from_numpy(importance()))
