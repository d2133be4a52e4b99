"""`python -m yesnt.training FOLDER`: bodies, people, things, weights, second opinion; resumes what was begun."""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from yesnt.capture_stage.tools import anny_only
from yesnt.decompose.network import Network, NetworkShape
from yesnt.decompose.weights import load_weights
from yesnt.training.auxiliary import OpinionSettings, make_opinion
from yesnt.training.bodies import make_bodies
from yesnt.training.feature_archive import subjects
from yesnt.training.pictures import everybody, make_person, make_thing
from yesnt.training.trainer import Trainer, TrainingSettings, train
from yesnt.training.weighting import Weigher, WeighingSettings, weigh, with_opinion

log = logging.getLogger("yesnt.train")


def main(argv: Sequence[str] | None = None) -> int:
    """The command: everything below FOLDER may be killed at any moment and goes on where it stopped."""
    options = _parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    torch.set_num_threads(options.threads)
    options.folder.mkdir(parents=True, exist_ok=True)
    settings = TrainingSettings(
        seed=options.seed, reading=options.reading, drawing=options.drawing, settling=options.settling,
        people=options.people, things=options.things,
    )  # fmt: skip
    if options.only != "weights" and settings.people:
        _make_people(options.folder, settings)
    if options.only != "weights":
        _make_things(options.folder, settings)
    if options.only != "pictures":
        network = load_weights(options.base)[0] if options.base else _train(options.folder, settings)
        if options.opining:
            _hear(options.folder, settings, network, options)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="yesnt.training", description=__doc__)
    parser.add_argument("folder", type=Path, help="bodies, pictures, checkpoint and weights go here")
    parser.add_argument(
        "--reading", type=int, default=TrainingSettings.reading, help="steps of learning what to expect"
    )
    parser.add_argument("--drawing", type=int, default=TrainingSettings.drawing, help="steps of learning to draw")
    parser.add_argument("--settling", type=int, default=TrainingSettings.settling, help="steps of the world as it is")
    parser.add_argument("--base", type=Path, help="weights to start from, in place of these three parts")
    parser.add_argument(
        "--opining", type=int, default=OpinionSettings.steps, help="steps of the second opinion; 0: there is none"
    )
    parser.add_argument("--weighing", type=int, default=WeighingSettings.steps, help="steps of weighing the two")
    parser.add_argument("--people", type=int, default=TrainingSettings.people, help="0: none, without `anny`")
    parser.add_argument("--things", type=int, default=TrainingSettings.things, help="single things; 0: none")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--only", choices=("pictures", "weights"), help="one part; they may run side by side")
    return parser


def _make_people(folder: Path, settings: TrainingSettings) -> None:
    bodies = make_bodies(settings.seed, folder / "bodies", anny_only(folder))
    start, made = time.monotonic(), 0
    numbers = everybody()[: settings.people]
    for count, number in enumerate(numbers, 1):
        made += make_person(folder, settings.seed, number, bodies)
        if made and count % 20 == 0:
            log.info("person %d of %d, %.1f s each", count, len(numbers), (time.monotonic() - start) / made)


def _make_things(folder: Path, settings: TrainingSettings) -> None:
    made = sum(make_thing(folder, settings.seed, number) for number in range(settings.things))
    log.info("%d things, %d of them new", settings.things, made)


def _train(folder: Path, settings: TrainingSettings) -> Network:
    trainer = Trainer(settings, NetworkShape(), folder)
    checkpoint = folder / "checkpoint.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint)
    start, begun = time.monotonic(), trainer.step
    for step, loss in train(trainer, folder):
        rate = (step - begun) / (time.monotonic() - start)
        log.info("step %d of %d, loss %.4f, %.2f steps/s", step, settings.steps, loss, rate)
    return trainer.averaged.eval()


def _hear(folder: Path, settings: TrainingSettings, network: Network, options: argparse.Namespace) -> None:
    asked = OpinionSettings(settings.seed, steps=options.opining)
    people, things = min(asked.people, settings.people), min(asked.things, settings.things)
    learnt, kept = subjects(folder, settings.seed, people, things)
    opinion = make_opinion(folder, asked, learnt, kept)
    weigher = Weigher(WeighingSettings(settings.seed, options.weighing), with_opinion(network, opinion), kept)
    checkpoint = folder / "weighing.pt"
    if checkpoint.exists():
        weigher.resume(checkpoint)
    for step, loss in weigh(weigher, folder):
        log.info("weighing, step %d of %d, loss %.4f", step, options.weighing, loss)


if __name__ == "__main__":
    raise SystemExit(main())
