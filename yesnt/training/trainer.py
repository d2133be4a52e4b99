"""Trains estimator and denoiser. Randomness is keyed by the step: a resumed training equals an uninterrupted one."""

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
from yesnt.training.checkpoint import read_state, write_state
from yesnt.training.image_archive import (
    OBJECTS,
    PEOPLE,
    STYLE_GROUPS,
    interleaved_people,
    object_path,
    open_views,
    person_path,
    style_of,
)
from yesnt.training.losses import context_loss, energy_score, estimator_loss
from yesnt.training.sample_pairs import SamplePairs
from yesnt.training.synthetic.dataset import Augmentation, Patches, crop, draw_patches, recolour_garments
from yesnt.training.synthetic.materials import CLASSES, MaterialStyle, class_weights

_IMAGE_TIMEOUT = 900.0
"""Seconds that a step waits for an image which another process renders."""

_MAIN_AUGMENTATION = Augmentation(
    MaterialStyle(cloth_print=0.35, borrowed_colour=0.3, solid_print=0.4), colour_mixing=0.4, recoloured=0.4
)
"""Strong colour augmentation: colour alone does not predict the material, so that shape is learnt."""

_FINE_TUNING_AUGMENTATION = Augmentation(
    MaterialStyle(cloth_print=0.1, borrowed_colour=0.1, solid_print=0.1), colour_mixing=0.1, recoloured=0.1
)
"""Weak colour augmentation with realistic materials, so that the predictive value of colour is learnt last."""

_FINE_TUNING_STYLES = (0.6, 0.2, 0.2)
"""Probability of each style group during fine-tuning; before, all are equally likely."""


@dataclass(frozen=True)
class TrainingSettings:
    """Everything that determines the weights.

    Attributes:
        seed: seed of data, noise and initial weights.
        estimator_steps: steps of the first phase, which trains the estimator.
        denoiser_steps: steps of the second phase, which trains the denoiser, and the estimator at a fifth of its rate.
        fine_tuning_steps: steps of the third phase, which trains both on realistic materials.
        batch: patches per step.
        people_patches: patches per step that show people; the rest shows synthetic scenes.
        object_patches: patches per step that show a procedural object from step `objects_after` on; half of them
            replace patches of people.
        people: people of the archive that are used; 0: none.
        objects: procedural objects of the archive that are used; 0: none.
        objects_after: first step that shows procedural objects.
        first: people that the archive must hold before the first step.
        every: steps after which one more person is used, so that rendering and training can run at the same time.
        patch: side of a patch in pixels.
        rate: highest learning rate.
        ema: decay of the exponential moving average of the weights.
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
        """Steps of all phases."""
        return self.estimator_steps + self.denoiser_steps + self.fine_tuning_steps


class Trainer:
    """Network, averaged network and optimiser at a training step.

    Args:
        settings: data, phases and rates.
        shape: sizes of the network.
        folder: folder that holds the archive of people and objects.
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
        self._samples = SamplePairs(settings.seed, settings.patch)

    def advance(self) -> float:
        """Runs one training step and returns its loss.

        Raises:
            JobError: an image of the archive is missing.
        """
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
        for name, average in self.averaged.state_dict().items():
            if average.is_floating_point():  # all but the counters of the norms
                average.lerp_(state[name], 1 - decay)
        return float(loss.detach())

    def save(self, path: Path) -> None:
        """Writes a checkpoint atomically."""
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
        """Restores the state of a checkpoint.

        Raises:
            JobError: the file has another format.
        """
        state = read_state(path)
        self.network.load_state_dict(state["network"])
        self.class_head.load_state_dict(state["class_head"])
        self.context_head.load_state_dict(state["context_head"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]

    def _patches(self) -> Patches:
        s = self.settings
        objects = s.object_patches if s.objects and self.step >= s.objects_after else 0
        people = s.people_patches - objects // 2 if s.people else 0
        rng = np.random.Generator(np.random.Philox(key=[s.seed, 1_000_000_000 + self.step]))
        crops = [self._person_crop(rng) for _ in range(people)] + [self._object_crop(rng) for _ in range(objects)]
        scenes = [
            draw_patches(s.seed, 1_000_000 + self.step * s.batch + i, 1, s.patch, self._augmentation)
            for i in range(s.batch - len(crops))
        ]
        return Patches.join([*([Patches.stack(crops)] if crops else []), *scenes])

    def _person_crop(self, rng: np.random.Generator) -> Patches:
        """Crop of one of the people that the archive holds at this step."""
        s = self.settings
        style = STYLE_GROUPS[self._style_group(rng)][1]
        available = self._people[: s.first + self.step // s.every]
        people = [number for number in available if style_of(number) == style]
        path = person_path(self.folder, s.seed, people[int(rng.integers(len(people)))])
        await_image(path)
        views = open_views(path)
        image = views[int(rng.integers(len(views)))]
        shrink = draw_shrink(rng)
        if rng.random() < self._augmentation.recoloured:
            image = recolour_garments(rng, image)
        return crop(rng, image, s.patch, shrink, self._augmentation.colour_mixing)

    def _object_crop(self, rng: np.random.Generator) -> Patches:
        """Crop of one of the procedural objects."""
        s = self.settings
        path = object_path(self.folder, s.seed, int(rng.integers(s.objects)))
        await_image(path)
        views = open_views(path)
        image = views[int(rng.integers(len(views)))]
        return crop(rng, image, s.patch, draw_shrink(rng), self._augmentation.colour_mixing)

    @property
    def _fine_tuning(self) -> bool:
        return self.step >= self.settings.estimator_steps + self.settings.denoiser_steps

    @property
    def _augmentation(self) -> Augmentation:
        return _FINE_TUNING_AUGMENTATION if self._fine_tuning else _MAIN_AUGMENTATION

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
        rgb, matte, truth, kind, context, location, context_truth, context_kind = (
            torch.from_numpy(np.ascontiguousarray(plane)) for plane in patches.planes()[:-1]
        )
        clean = 2 * truth - 1
        features = self.network.estimator.context(context)
        condition = self.network.estimator.from_features(rgb, matte, features, location)
        importance = torch.from_numpy(class_weights())
        weights = matte * importance[kind.clamp_min(0)][:, None]
        loss = estimator_loss(condition, self.class_head(condition), clean, kind, weights, importance)
        loss = loss + 0.5 * context_loss(self.context_head(features), context_truth, context_kind, importance)
        if self.step < self.settings.estimator_steps:
            return loss
        # The gradient of the energy score of two samples is noisy; passed on, it would degrade the estimator.
        samples = self._samples.draw(self.network.denoiser, condition.detach(), clean, self.step)
        return loss + energy_score(*samples, clean, weights)


def rate_schedule(done: int, length: int) -> float:
    """Returns the factor of the highest learning rate: linear warm-up over 100 steps, then a cosine decay to 0.02.

    Args:
        done: finished steps of the phase.
        length: steps of the phase.
    """
    return min(1.0, (done + 1) / 100) * (0.02 + 0.98 * 0.5 * (1 + float(np.cos(np.pi * done / length))))


def draw_shrink(rng: np.random.Generator) -> float:
    """Draws the factor by which the shown region of an image exceeds the side of the patch, 1 .. 1.65."""
    return float(np.exp(rng.uniform(0, 0.5))) if rng.random() < 0.4 else 1.0


def await_image(path: Path) -> None:
    """Waits for an archive file that another process writes.

    Raises:
        JobError: the file does not appear within `_IMAGE_TIMEOUT`.
    """
    waited = 0.0
    while not path.exists():
        if waited > _IMAGE_TIMEOUT:
            raise JobError(
                "An image of the archive is missing",
                str(path),
                "the people and objects of the settings",
                "run `python -m yesnt.training FOLDER --only images`, or ask for fewer with --people and --objects",
            )
        time.sleep(1.0)
        waited += 1.0


def train(trainer: Trainer, folder: Path, every: int = 100) -> Iterator[tuple[int, float]]:
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
            trainer.save(folder / "checkpoint.pt")
            save_weights(trainer.averaged, folder / "embedded.safetensors")
            yield trainer.step, float(np.mean(losses))
            losses.clear()
