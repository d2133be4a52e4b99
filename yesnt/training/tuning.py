"""Tunes the second opinion as a whole: perceptron and the trunk's later stages together, on whole looks at subjects.

As published the trunk tells things apart, not what they are made of. Its early stages, edges and textures at a quarter
of the resolution, stay as they are: they are half of the work of a step, and what keeps photographs in mind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from yesnt.decompose.opinion import Opinion, displayed, enlarged
from yesnt.training.checkpoint import write_state
from yesnt.training.losses import whole_loss
from yesnt.training.pictures import open_views
from yesnt.training.surveys import Survey, draw_survey
from yesnt.training.synthetic.materials import CLASSES, importance
from yesnt.training.trainer import course


@dataclass(frozen=True)
class TuningSettings:
    """What determines the tuned opinion.

    Attributes:
        seed: of looks and of the class head.
        steps: of training.
        batch: looks per step.
        rate: highest learning rate.
        frozen: stages of the trunk, its stem apart, that stay as published.
        dropout: share of the perceptron's first layer that is silenced in a step.
        ema: decay of the averaged weights.
    """

    seed: int = 0
    steps: int = 2400
    batch: int = 4
    rate: float = 3e-4
    frozen: int = 2
    dropout: float = 0.3
    ema: float = 0.99


class Tuner:
    """Opinion, averaged opinion and optimiser at a step.

    Args:
        settings: what to do.
        opinion: where to start.
        paths: files of the archive that are shown.
    """

    def __init__(self, settings: TuningSettings, opinion: Opinion, paths: Sequence[Path]) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self._paths = settings, paths
        self.opinion = opinion.requires_grad_(True)
        frozen = [opinion.trunk.stem, *opinion.trunk.stages[: settings.frozen]]
        for part in frozen:
            part.requires_grad_(False)
        self.classes = nn.Conv2d(opinion.hidden.out_channels, len(CLASSES), 1)
        self.averaged = {name: value.clone() for name, value in opinion.state_dict().items()}
        learnt = [p for p in opinion.parameters() if p.requires_grad]
        self.optimiser = torch.optim.AdamW([*learnt, *self.classes.parameters()], lr=settings.rate, weight_decay=0.01)
        self.step = 0

    def advance(self) -> float:
        """One optimiser step; returns its loss."""
        s = self.settings
        rng = np.random.Generator(np.random.Philox(key=[s.seed, 5_000_000_000 + self.step]))
        loss = self._loss([self._look(rng) for _ in range(s.batch)])
        self.optimiser.param_groups[0]["lr"] = s.rate * course(self.step, s.steps)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.optimiser.param_groups[0]["params"], 1.0)
        self.optimiser.step()
        self.step += 1
        for name, value in self.opinion.state_dict().items():
            self.averaged[name].lerp_(value, 1 - min(s.ema, (1 + self.step) / (10 + self.step)))
        return float(loss.detach())

    def result(self) -> Opinion:
        """The averaged opinion."""
        opinion = Opinion(self.opinion.hidden.in_channels, self.opinion.hidden.out_channels)
        opinion.load_state_dict(self.averaged)
        return opinion.eval().requires_grad_(False)

    def save(self, path: Path) -> None:
        """Writes a checkpoint whole or not at all."""
        state = {
            "step": self.step,
            "opinion": self.opinion.state_dict(),
            "classes": self.classes.state_dict(),
            "averaged": self.averaged,
            "optimiser": self.optimiser.state_dict(),
        }
        write_state(path, state)

    def resume(self, path: Path) -> None:
        """Continues from a checkpoint."""
        state = torch.load(path, weights_only=True)
        self.opinion.load_state_dict(state["opinion"])
        self.classes.load_state_dict(state["classes"])
        self.averaged = state["averaged"]
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]

    def _look(self, rng: np.random.Generator) -> Survey:
        views = open_views(self._paths[int(rng.integers(len(self._paths)))])
        return draw_survey(rng, views[int(rng.integers(len(views)))])

    def _loss(self, looks: Sequence[Survey]) -> torch.Tensor:
        picture, truth, kind = (
            torch.from_numpy(np.stack([getattr(look, name) for look in looks])) for name in ("picture", "truth", "kind")
        )
        scores = self._scores(picture)
        return whole_loss(scores, truth, kind, torch.from_numpy(importance()))

    def _scores(self, picture: torch.Tensor) -> torch.Tensor:
        """As `Opinion.forward`, unclipped and with the classes, which are for training only."""
        opinion, side = self.opinion, picture.shape[-1] // 4
        told = (level(x) for level, x in zip(opinion.levels, opinion.trunk(displayed(picture)), strict=True))
        first = F.relu(sum(enlarged(x, side) for x in told) + opinion.bias[:, None, None])
        hidden = F.relu(opinion.hidden(F.dropout2d(first, self.settings.dropout)))
        return torch.cat([opinion.last(hidden), self.classes(hidden)], 1)


def tune(tuner: Tuner, folder: Path, every: int = 50) -> Iterator[tuple[int, float]]:
    """Runs to the last step; yields (step, mean loss) and saves a checkpoint every `every` steps."""
    losses: list[float] = []
    while tuner.step < tuner.settings.steps:
        losses.append(tuner.advance())
        if tuner.step % every == 0 or tuner.step == tuner.settings.steps:
            tuner.save(folder / "tuning.pt")
            yield tuner.step, float(np.mean(losses))
            losses.clear()
