"""Trains the embedded model; everything random is keyed by the step, so a resumed training is an uninterrupted one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from yesnt.core.errors import JobError
from yesnt.decompose.network import Network, NetworkShape
from yesnt.decompose.weights import PATCH, channels_last, save_weights
from yesnt.training.checkpoint import write_state
from yesnt.training.draws import SamplePairs
from yesnt.training.losses import context_loss, energy_score, estimator_loss
from yesnt.training.pictures import (
    OBJECTS,
    PEOPLE,
    STYLE_GROUPS,
    interleaved_people,
    object_path,
    open_views,
    person_path,
    style_of,
)
from yesnt.training.synthetic.dataset import Augmentation, Patches, crop, draw_patches, recolour_garments
from yesnt.training.synthetic.materials import CLASSES, MaterialStyle, class_weights

_PATIENCE = 900.0
"""Seconds that a step waits for a picture which another process is to make."""


_AUGMENTATION = Augmentation(
    MaterialStyle(cloth_print=0.35, borrowed_colour=0.3, solid_print=0.4), colour_mixing=0.4, recoloured=0.4
)
"""Pictures that punish going by colour, so that shapes are learnt."""

_FINE_TUNING = Augmentation(
    MaterialStyle(cloth_print=0.1, borrowed_colour=0.1, solid_print=0.1), colour_mixing=0.1, recoloured=0.1
)
"""Pictures more like the world, in which a colour tells something too: what is learnt last is how much."""

_FINE_TUNING_STYLES = (0.6, 0.2, 0.2)
"""How often each wardrobe is shown while the network settles; before, each as often as any other."""


@dataclass(frozen=True)
class TrainingSettings:
    """What determines the weights.

    Attributes:
        seed: of data, noise and first weights.
        estimator_steps: steps of the first part, in which the estimator alone learns what to expect.
        denoiser_steps: steps of the second part, in which the denoiser learns to draw and the estimator learns on slowly.
        fine_tuning_steps: steps of the last part: both learn on, from pictures more like the world.
        batch: patches per step.
        people_patches: how many of them show people; the others show heaps of things.
        object_patches: how many show a single thing from step `objects_after` on, half of them in a person's place.
        people: dressed people of the archive that are shown; 0: none.
        objects: objects of the archive that are shown; 0: none.
        objects_after: steps in which people and heaps are enough to learn from.
        first: people that must be there before the first step.
        every: steps after which one more is asked for, so that pictures can be made while the training runs.
        patch: side of a patch.
        rate: highest learning rate.
        ema: decay of the averaged weights.
    """

    seed: int = 0
    estimator_steps: int = 3600
    denoiser_steps: int = 700
    fine_tuning_steps: int = 600
    batch: int = 8
    people_patches: int = 5
    object_patches: int = 2
    people: int = PEOPLE
    objects: int = OBJECTS
    objects_after: int = 1500
    first: int = 120
    every: int = 3
    patch: int = PATCH
    rate: float = 1.0e-3
    ema: float = 0.997

    @property
    def steps(self) -> int:
        """Of all parts."""
        return self.estimator_steps + self.denoiser_steps + self.fine_tuning_steps


class Trainer:
    """Network, averaged network and optimiser at a step.

    Args:
        settings: what to do.
        shape: of the network.
        folder: holds the archive of people.
    """

    def __init__(self, settings: TrainingSettings, shape: NetworkShape, folder: Path) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.folder = settings, folder
        self.network = channels_last(Network(shape))
        self.class_head = torch.nn.Conv2d(shape.condition, len(CLASSES), 1)
        self.context_head = torch.nn.Conv2d(shape.context[1], 2 + len(CLASSES), 1)
        self._people = interleaved_people()[: settings.people]
        self.averaged = Network(shape).requires_grad_(False)
        self.averaged.load_state_dict(self.network.state_dict())
        groups = [
            {
                "params": [
                    *self.network.estimator.parameters(),
                    *self.class_head.parameters(),
                    *self.context_head.parameters(),
                ]
            },
            {"params": list(self.network.denoiser.parameters())},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.rate, weight_decay=0.02, betas=(0.9, 0.98))
        self.step = 0
        self._draws = SamplePairs(settings.seed, settings.patch)

    def advance(self) -> float:
        """One optimiser step; returns its loss."""
        patches = self._patches()
        for group, rate in zip(self.optimiser.param_groups, self._rates(), strict=True):
            group["lr"] = rate
        loss = self._loss(patches)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_([p for g in self.optimiser.param_groups for p in g["params"]], 1.0)
        self.optimiser.step()
        self.step += 1
        decay = min(self.settings.ema, (1 + self.step) / (10 + self.step))
        state = self.network.state_dict()
        for name, kept in self.averaged.state_dict().items():
            if kept.is_floating_point():  # all but the norms' counters
                kept.lerp_(state[name], 1 - decay)
        return float(loss.detach())

    def save(self, path: Path) -> None:
        """Writes a checkpoint whole or not at all."""
        state = {
            "step": self.step,
            "network": self.network.state_dict(),
            "class_head": self.class_head.state_dict(),
            "context_head": self.context_head.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        write_state(path, state)

    def resume(self, path: Path) -> None:
        """Continues from a checkpoint."""
        state = torch.load(path, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.class_head.load_state_dict(state["class_head"])
        self.context_head.load_state_dict(state["context_head"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]

    def _patches(self) -> Patches:
        s = self.settings
        things = s.object_patches if s.objects and self.step >= s.objects_after else 0
        people = s.people_patches - things // 2 if s.people else 0
        rng = np.random.Generator(np.random.Philox(key=[s.seed, 1_000_000_000 + self.step]))
        crops = [self._person_crop(rng) for _ in range(people)] + [self._object_crop(rng) for _ in range(things)]
        heaps = [
            draw_patches(s.seed, 1_000_000 + self.step * s.batch + i, 1, s.patch, self._augmentation)
            for i in range(s.batch - len(crops))
        ]
        return Patches.join([*([Patches.stack(crops)] if crops else []), *heaps])

    def _person_crop(self, rng: np.random.Generator) -> Patches:
        """A crop of one of the people that a training at this step may count on."""
        s = self.settings
        style = STYLE_GROUPS[self._style_group(rng)][1]
        there = self._people[: s.first + self.step // s.every]
        people = [number for number in there if style_of(number) == style]
        path = person_path(self.folder, s.seed, people[int(rng.integers(len(people)))])
        await_picture(path)
        views = open_views(path)
        picture = views[int(rng.integers(len(views)))]
        shrink = draw_shrink(rng)
        if rng.random() < self._augmentation.recoloured:
            picture = recolour_garments(rng, picture)
        return crop(rng, picture, s.patch, shrink, self._augmentation.colour_mixing)

    def _object_crop(self, rng: np.random.Generator) -> Patches:
        """A crop of one of the single things."""
        s = self.settings
        path = object_path(self.folder, s.seed, int(rng.integers(s.objects)))
        await_picture(path)
        views = open_views(path)
        picture = views[int(rng.integers(len(views)))]
        return crop(rng, picture, s.patch, draw_shrink(rng), self._augmentation.colour_mixing)

    @property
    def _fine_tuning(self) -> bool:
        return self.step >= self.settings.estimator_steps + self.settings.denoiser_steps

    @property
    def _augmentation(self) -> Augmentation:
        return _FINE_TUNING if self._fine_tuning else _AUGMENTATION

    def _style_group(self, rng: np.random.Generator) -> int:
        if self._fine_tuning:
            return int(rng.choice(len(STYLE_GROUPS), p=_FINE_TUNING_STYLES))
        return int(rng.integers(len(STYLE_GROUPS)))

    def _rates(self) -> tuple[float, float]:
        """Learning rates of estimator and denoiser."""
        s = self.settings
        if self._fine_tuning:
            rate = 0.4 * s.rate * rate_schedule(self.step - s.estimator_steps - s.denoiser_steps, s.fine_tuning_steps)
            return rate, rate
        if self.step < s.estimator_steps:
            return s.rate * rate_schedule(self.step, s.estimator_steps), 0.0
        rate = s.rate * rate_schedule(self.step - s.estimator_steps, s.denoiser_steps)
        return rate / 5, rate

    def _loss(self, patches: Patches) -> torch.Tensor:
        rgb, matte, truth, kind, whole, place, context_truth, context_kind = (
            torch.from_numpy(np.ascontiguousarray(plane)) for plane in patches.planes()[:-1]
        )
        clean = 2 * truth - 1
        features = self.network.estimator.context(whole)
        condition = self.network.estimator.from_features(rgb, matte, features, place)
        counts = torch.from_numpy(class_weights())
        weights = matte * counts[kind.clamp_min(0)][:, None]
        loss = estimator_loss(condition, self.class_head(condition), clean, kind, weights, counts)
        loss = loss + 0.5 * context_loss(self.context_head(features), context_truth, context_kind, counts)
        if self.step < self.settings.estimator_steps:
            return loss
        # Two random draws give signs, not errors: a noisy gradient, which passed down would undo what was read.
        draws = self._draws.pair(self.network.denoiser, condition.detach(), clean, self.step)
        return loss + energy_score(*draws, clean, weights)


def rate_schedule(done: int, length: int) -> float:
    """Share of the highest rate: a linear warm-up, then a cosine to a fiftieth."""
    return min(1.0, (done + 1) / 100) * (0.02 + 0.98 * 0.5 * (1 + float(np.cos(np.pi * done / length))))


def draw_shrink(rng: np.random.Generator) -> float:
    """How many times its size of a picture a patch shows."""
    return float(np.exp(rng.uniform(0, 0.5))) if rng.random() < 0.4 else 1.0


def await_picture(path: Path) -> None:
    """Waits for a picture that is being made beside the training."""
    waited = 0.0
    while not path.exists():
        if waited > _PATIENCE:
            raise JobError(
                "A picture of the archive is missing",
                str(path),
                "the people that the settings count on",
                "run `python -m yesnt.training FOLDER --only pictures`, or ask for fewer with --people and --things",
            )
        time.sleep(1.0)
        waited += 1.0


def train(trainer: Trainer, folder: Path, every: int = 100) -> Iterator[tuple[int, float]]:
    """Runs to the last step; yields (step, mean loss) and saves a checkpoint and weights every `every` steps."""
    losses: list[float] = []
    while trainer.step < trainer.settings.steps:
        losses.append(trainer.advance())
        if trainer.step % every == 0 or trainer.step == trainer.settings.steps:
            trainer.save(folder / "checkpoint.pt")
            save_weights(trainer.averaged, folder / "embedded.safetensors")
            yield trainer.step, float(np.mean(losses))
            losses.clear()
