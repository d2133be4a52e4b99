"""Bodies of the synthetic people: shapes drawn from a seed, made by the parametric human model, and random poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from yesnt.capture_stage.pose import Array, Body, arm, fist, leg, turn
from yesnt.capture_stage.tools import Tools, run_anny

PHENOTYPE = ("gender", "age", "muscle", "weight", "height", "proportions")
"""Shape parameters of the parametric human model that are drawn."""
BODIES = 24
"""Number of different bodies."""


def draw_phenotype(seed: int, number: int) -> dict[str, float]:
    """Draws the shape of a body: parameters in [0, 1] by name; age begins at youth.

    Args:
        seed: seed of the training.
        number: number of the body.
    """
    rng = np.random.Generator(np.random.Philox(key=[seed, 7_000_000 + number]))
    values = rng.beta(1.4, 1.4, len(PHENOTYPE))
    values[PHENOTYPE.index("age")] = rng.uniform(0.45, 1.0)
    return {name: round(float(value), 4) for name, value in zip(PHENOTYPE, values, strict=True)}


def make_bodies(seed: int, folder: Path, tools: Tools) -> tuple[Path, ...]:
    """Makes the bodies in rest pose as files; existing files are kept.

    Args:
        seed: seed of the training.
        folder: folder of the files.
        tools: where the parametric human model is installed.

    Returns:
        Paths of the bodies.

    Raises:
        MissingPartError: the parametric human model is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"body.{seed}.{number:03d}.npz" for number in range(BODIES))
    missing = [(path, draw_phenotype(seed, n)) for n, path in enumerate(paths) if not path.exists()]
    if missing:
        run_anny(tools, [{"out": str(path), "phenotype": shape} for path, shape in missing], folder)
    return paths


def draw_pose(rng: np.random.Generator, body: Body) -> dict[str, Array]:
    """Draws a standing, stepping or gesturing pose within the range of motion of every joint.

    Args:
        rng: source of every choice.
        body: body in rest pose.

    Returns:
        Rotation [3, 3] by name of bone.
    """
    step = rng.normal(0, 14)
    pose = {
        **leg("L", step + rng.uniform(0, 12), abs(rng.normal(0, 18)), rng.normal(0, 4)),
        **leg("R", -step + rng.uniform(0, 12), abs(rng.normal(0, 18)), rng.normal(0, 4)),
        "root": turn("z", rng.normal(0, 10)),
        "spine03": turn("z", rng.normal(0, 10)) @ turn("x", rng.normal(2, 6)) @ turn("y", rng.normal(0, 5)),
        "neck01": turn("z", rng.normal(0, 14)) @ turn("x", rng.normal(0, 6)),
        "head": turn("x", rng.normal(0, 5)) @ turn("y", rng.normal(0, 4)),
    }
    for side in "LR":
        if rng.random() < 0.5:  # hanging
            pose |= arm(body, side, rng.uniform(10, 32), rng.normal(0, 16), 0, rng.uniform(5, 50))
        else:
            bend = (rng.uniform(-60, 26), rng.uniform(0, 70), rng.uniform(-5, 60), rng.uniform(10, 116))
            pose |= arm(body, side, *bend)
        if rng.random() < 0.4:
            pose |= fist(side, rng.uniform(10, 65))
    return pose
