"""Trains the embedded model on pictures of its own making: `python -m yesnt.decompose.training --help`."""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional as F

from yesnt.decompose.network import Network, NetworkShape, noised
from yesnt.decompose.noise_planes import member_noise
from yesnt.decompose.synthetic.dataset import Patches, draw_patches
from yesnt.decompose.synthetic.materials import CLASSES
from yesnt.decompose.weights import SMOOTH_SIGMAS, channels_last, save_weights

log = logging.getLogger("yesnt.train")


@dataclass(frozen=True)
class TrainingSettings:
    """What determines the weights.

    Attributes:
        seed: of data, noise and first weights.
        reading: steps of the first part, in which the reader alone learns, from its hints.
        steps: optimiser steps in all.
        batch: patches per step.
        crops: patches cropped from one picture.
        patch: side of a training patch: smaller than the one it will serve, since what counts is how many materials
            are seen, not how many pixels of each.
        rate: highest learning rate; in the second part the reader has a third of it.
        ema: decay of the averaged weights.
        bfloat16: compute in bfloat16 (several times faster on CPUs with AMX).
    """

    seed: int = 0
    reading: int = 4200
    steps: int = 5700
    batch: int = 24
    crops: int = 1
    patch: int = 64
    rate: float = 1e-3
    ema: float = 0.998
    bfloat16: bool = True


class Trainer:
    """Network, averaged network and optimiser at a step; everything random is keyed by the step."""

    def __init__(self, settings: TrainingSettings, shape: NetworkShape) -> None:
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.network = channels_last(Network(shape))
        self.hints = torch.nn.Conv2d(shape.condition, 2 + len(CLASSES), 1)
        self.averaged = Network(shape).requires_grad_(False)
        self.averaged.load_state_dict(self.network.state_dict())
        # Decay bounds the weights that a norm makes scale-free; ten times this rate once blew up the coarse levels, and
        # the network went on with colour alone.
        groups = [
            {"params": [*self.network.reader.parameters(), *self.hints.parameters()]},
            {"params": list(self.network.denoiser.parameters())},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.rate, weight_decay=0.05, betas=(0.9, 0.98))
        self.step = 0
        self._noise = _noise_pool(settings.seed)

    def advance(self) -> float:
        """One optimiser step; returns its loss."""
        patches = self._patches()
        for group, rate in zip(self.optimiser.param_groups, self._rates(), strict=True):
            group["lr"] = rate
        loss = self._loss(*(torch.from_numpy(np.ascontiguousarray(p)) for p in patches.planes()))
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_([*self.network.parameters(), *self.hints.parameters()], 1.0)
        self.optimiser.step()
        self.step += 1
        decay = min(self.settings.ema, (1 + self.step) / (10 + self.step))
        for kept, new in zip(self.averaged.parameters(), self.network.parameters(), strict=True):
            kept.lerp_(new.detach(), 1 - decay)
        return float(loss.detach())

    def save(self, path: Path) -> None:
        """Writes a checkpoint whole or not at all."""
        state = {
            "step": self.step,
            "network": self.network.state_dict(),
            "hints": self.hints.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        part = path.with_suffix(".part")
        torch.save(state, part)
        part.replace(path)

    def resume(self, path: Path) -> None:
        """Continues from a checkpoint."""
        state = torch.load(path, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.hints.load_state_dict(state["hints"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]

    def _patches(self) -> Patches:
        s = self.settings
        pictures = s.batch // s.crops
        made = [draw_patches(s.seed, self.step * pictures + i, s.crops, s.patch) for i in range(pictures)]
        return Patches(*(np.concatenate(planes) for planes in zip(*(m.planes() for m in made), strict=True)))

    def _rates(self) -> tuple[float, float]:
        """Learning rates of reader and denoiser: in each part a linear warm-up, then a cosine to a hundredth."""
        s = self.settings
        reading = self.step < s.reading
        done, length = (self.step, s.reading) if reading else (self.step - s.reading, s.steps - s.reading)
        rate = s.rate * min(1.0, (done + 1) / 200) * (0.01 + 0.99 * 0.5 * (1 + float(np.cos(np.pi * done / length))))
        return (rate, 0.0) if reading else (rate / 3, rate)

    def _loss(self, rgb: torch.Tensor, matte: torch.Tensor, truth: torch.Tensor, kind: torch.Tensor) -> torch.Tensor:
        clean = 2 * truth - 1
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self.settings.bfloat16):
            condition = self.network.reader(rgb, matte)
            hints = self.hints(condition)
        loss = hint_loss(hints.float(), clean, kind, matte)
        if self.step < self.settings.reading:
            return loss
        # Two random draws give signs, not errors: a noisy gradient, which passed down in full kept the reader from
        # learning what a garment is made of.
        gentle = 0.2 * condition + 0.8 * condition.detach()
        return loss + energy_score(*self._draws(gentle, clean), clean, matte)

    def _draws(self, condition: torch.Tensor, clean: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Two independent draws for every patch, each from its own noise at the patch's random time."""
        generator = torch.Generator().manual_seed(self.settings.seed * 1_000_003 + self.step)
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
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self.settings.bfloat16):
            drawn = self.network.denoiser(
                torch.cat([state, other]), smooth, torch.cat([condition, condition]), torch.cat([times, times])
            )
        first, second = drawn.float().chunk(2)
        return first, second

    def _smooth(self, generator: torch.Generator, rows: int, patch: int) -> torch.Tensor:
        """Crops of ready noise fields, of different fields for the two draws of one patch."""
        fields = torch.randperm(len(self._noise), generator=generator)[:rows].tolist()
        places = torch.randint(0, self._noise.shape[-1] - patch, (rows, 2), generator=generator).tolist()
        return torch.stack(
            [self._noise[f, :, y : y + patch, x : x + patch] for f, (y, x) in zip(fields, places, strict=True)]
        )


def energy_score(first: torch.Tensor, second: torch.Tensor, clean: torch.Tensor, matte: torch.Tensor) -> torch.Tensor:
    """Energy score of two independent draws against the truth, per pixel and of local means.

    E|X - y| - E|X - X'| / 2 (Gneiting & Raftery 2007, eq. 21) is least in expectation if and only if X is distributed
    as y: the network learns to draw, with the right spread, in a single step (distributional diffusion,
    De Bortoli et al. 2025).

    Args:
        first: [B, 2, P, P] a draw.
        second: [B, 2, P, P] another.
        clean: [B, 2, P, P] truth.
        matte: [B, 1, P, P] weights.
    """
    total = torch.zeros(())
    for size, weight in ((1, 1.0), (4, 0.5), (16, 0.5), (matte.shape[-1], 0.3)):
        cover = F.avg_pool2d(matte, size)

        def local(x: torch.Tensor, cover: torch.Tensor = cover, size: int = size) -> torch.Tensor:
            return F.avg_pool2d(x * matte, size) / cover.clamp_min(1e-3)

        a, b, y = local(first), local(second), local(clean)
        score = 0.5 * ((a - y).abs() + (b - y).abs()) - 0.5 * (a - b).abs()
        total = total + weight * (score * cover).sum() / (2 * cover.sum())
    return total


def hint_loss(hints: torch.Tensor, clean: torch.Tensor, kind: torch.Tensor, matte: torch.Tensor) -> torch.Tensor:
    """Helps the reader early: from its features the mean material and the class must be linear to read.

    Args:
        hints: [B, 2 + classes, P/2, P/2] mean material, class scores.
        clean: [B, 2, P, P] truth in [-1, 1].
        kind: [B, P, P] class, -1 outside the matte.
        matte: [B, 1, P, P] weights.
    """
    cover = F.avg_pool2d(matte, 2)
    mean = F.avg_pool2d(clean * matte, 2) / cover.clamp_min(1e-3)
    square = ((hints[:, :2] - mean).square() * cover).sum() / (2 * cover.sum())
    return square + 0.25 * F.cross_entropy(hints[:, 2:], kind[:, ::2, ::2], ignore_index=-1)


def _noise_pool(seed: int, count: int = 96, side: int = 256) -> torch.Tensor:
    """[count, smooth planes, side, side] ready fields: blurring anew at every step would cost more than the network."""
    return torch.from_numpy(np.stack([member_noise((seed, -1, k), side, side, SMOOTH_SIGMAS) for k in range(count)]))


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


def main(argv: Sequence[str] | None = None) -> int:
    """The command: trains in FOLDER, continuing where it stopped."""
    parser = argparse.ArgumentParser(prog="yesnt train", description=__doc__)
    parser.add_argument("folder", type=Path, help="checkpoint and weights go here")
    parser.add_argument("--steps", type=int, default=TrainingSettings.steps)
    parser.add_argument("--reading", type=int, default=TrainingSettings.reading)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--float32", action="store_true", help="do not compute in bfloat16")
    options = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    torch.set_num_threads(options.threads)
    options.folder.mkdir(parents=True, exist_ok=True)
    settings = replace(
        TrainingSettings(),
        reading=options.reading,
        steps=options.steps,
        seed=options.seed,
        bfloat16=not options.float32,
    )
    trainer = Trainer(settings, NetworkShape())
    checkpoint = options.folder / "checkpoint.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint)
    start, begun = time.monotonic(), trainer.step
    for step, loss in train(trainer, options.folder):
        rate = (step - begun) / (time.monotonic() - start)
        log.info("step %d of %d, loss %.4f, %.2f steps/s", step, settings.steps, loss, rate)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
