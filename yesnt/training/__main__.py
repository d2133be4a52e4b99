"""Trains the embedded model: `python -m yesnt.training FOLDER`.

Makes bodies, images of people and of procedural objects, then trains estimator, denoiser, auxiliary predictor and the
weighting of both predictions. An interrupted run resumes.
"""

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
from yesnt.training.auxiliary import AuxiliarySettings, make_auxiliary
from yesnt.training.bodies import make_bodies
from yesnt.training.feature_archive import subjects
from yesnt.training.image_archive import interleaved_people, make_object, make_person
from yesnt.training.trainer import Trainer, TrainingSettings, train
from yesnt.training.weighting import WeightingSettings, WeightingTrainer, train_weighting, with_auxiliary

log = logging.getLogger("yesnt.train")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command. All files lie below FOLDER; a killed run continues where it stopped.

    Args:
        argv: arguments without the program's name; None: those of the process.

    Returns:
        Exit status 0.
    """
    options = _parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    torch.set_num_threads(options.threads)
    options.folder.mkdir(parents=True, exist_ok=True)
    settings = TrainingSettings(
        seed=options.seed,
        estimator_steps=options.estimator_steps,
        denoiser_steps=options.denoiser_steps,
        fine_tuning_steps=options.fine_tuning_steps,
        people=options.people,
        objects=options.objects,
    )
    if options.only != "weights" and settings.people:
        _make_people(options.folder, settings)
    if options.only != "weights":
        _make_objects(options.folder, settings)
    if options.only != "images":
        network = load_weights(options.base)[0] if options.base else _train(options.folder, settings)
        if options.auxiliary_steps:
            _train_auxiliary(options.folder, settings, network, options)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="yesnt.training", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of bodies, images, checkpoints and weights")
    parser.add_argument(
        "--estimator-steps", type=int, default=TrainingSettings.estimator_steps, help="training steps of the estimator"
    )
    parser.add_argument(
        "--denoiser-steps", type=int, default=TrainingSettings.denoiser_steps, help="training steps of the denoiser"
    )
    parser.add_argument(
        "--fine-tuning-steps",
        type=int,
        default=TrainingSettings.fine_tuning_steps,
        help="fine-tuning steps on realistic materials",
    )
    parser.add_argument("--base", type=Path, help="weights file to use in place of these three phases")
    parser.add_argument(
        "--auxiliary-steps",
        type=int,
        default=AuxiliarySettings.steps,
        help="training steps of the auxiliary predictor; 0: none",
    )
    parser.add_argument(
        "--weighting-steps",
        type=int,
        default=WeightingSettings.steps,
        help="training steps of the weighting of both predictions",
    )
    parser.add_argument(
        "--people",
        type=int,
        default=TrainingSettings.people,
        help="dressed people in the archive; 0: none, then `anny` is not needed",
    )
    parser.add_argument(
        "--objects", type=int, default=TrainingSettings.objects, help="procedural objects in the archive; 0: none"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of data, noise and initial weights")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch")
    parser.add_argument("--only", choices=("images", "weights"), help="run one part; both may run at the same time")
    return parser


def _make_people(folder: Path, settings: TrainingSettings) -> None:
    bodies = make_bodies(settings.seed, folder / "bodies", anny_only(folder))
    start, made = time.monotonic(), 0
    numbers = interleaved_people()[: settings.people]
    for count, number in enumerate(numbers, 1):
        made += make_person(folder, settings.seed, number, bodies)
        if made and count % 20 == 0:
            log.info("person %d of %d, %.1f s each", count, len(numbers), (time.monotonic() - start) / made)


def _make_objects(folder: Path, settings: TrainingSettings) -> None:
    made = sum(make_object(folder, settings.seed, number) for number in range(settings.objects))
    log.info("%d objects, %d of them new", settings.objects, made)


def _train(folder: Path, settings: TrainingSettings) -> Network:
    trainer = Trainer(settings, NetworkShape(), folder)
    checkpoint = folder / "checkpoint.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint)
    start, first = time.monotonic(), trainer.step
    for step, loss in train(trainer, folder):
        rate = (step - first) / (time.monotonic() - start)
        log.info("step %d of %d, loss %.4f, %.2f steps/s", step, settings.steps, loss, rate)
    return trainer.averaged.eval()


def _train_auxiliary(folder: Path, settings: TrainingSettings, network: Network, options: argparse.Namespace) -> None:
    auxiliary_settings = AuxiliarySettings(settings.seed, steps=options.auxiliary_steps)
    people, objects = min(auxiliary_settings.people, settings.people), min(auxiliary_settings.objects, settings.objects)
    training, held_out = subjects(folder, settings.seed, people, objects)
    auxiliary = make_auxiliary(folder, auxiliary_settings, training, held_out)
    trainer = WeightingTrainer(
        WeightingSettings(settings.seed, options.weighting_steps), with_auxiliary(network, auxiliary), held_out
    )
    checkpoint = folder / "weighting.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint)
    for step, loss in train_weighting(trainer, folder):
        log.info("weighting, step %d of %d, loss %.4f", step, options.weighting_steps, loss)


if __name__ == "__main__":
    raise SystemExit(main())
