"""What a ground under the subject costs: processor seconds a frame of the embedded shot, with and without it.

    python -m tests.benchmarks.set_cost FOLDER [--frames 1004,1005,1006] [--rounds 3]

Runs relight, set and composite of single frames in this process, in turn with and without a set, and prints the least
of the rounds for each stage. Kernels are compiled and lights are prepared before anything is timed.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path
from typing import Any

import yaml

from tests.in_process import run_here
from yesnt.io.embedded_shot import SHOT
from yesnt.planning.stages import COMPOSITE, RELIGHT, SET
from yesnt.runtime.session import Session
from yesnt.tasks.composite import composite
from yesnt.tasks.relight import relight
from yesnt.tasks.set_stage import light_the_set
from yesnt.tasks.workspace import Workspace

TASKS = {RELIGHT: relight, SET: light_the_set, COMPOSITE: composite}


class Uncommitted(Workspace[Any]):
    """Computes and writes nothing to the store."""

    def commit(self, *_: Any, **__: Any) -> None:
        """Nothing."""


def main() -> None:
    """Prints a line a stage and the sum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", default="1004,1005,1006")
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args()
    if not chosen.folder.exists():
        shutil.copytree(SHOT, chosen.folder)
    sessions = [run_here(write(chosen.folder, on), "composite", chosen.frames) for on in (False, True)]
    frames = [int(frame) for frame in chosen.frames.split(",")]
    least: dict[tuple[str, bool], float] = {}
    for _ in range(chosen.rounds):
        for on, session in zip((False, True), sessions, strict=True):
            for stage, task in TASKS.items():
                if stage != SET or on:
                    spent = sum(seconds(session, stage, task, frame) for frame in frames) / len(frames)
                    least[stage.name, on] = min(spent, least.get((stage.name, on), spent))
    print("stage       without   with a ground (processor seconds a frame)")
    for stage in TASKS:
        print(f"{stage.name:10s} {least.get((stage.name, False), 0):8.2f} {least[stage.name, True]:9.2f}")
    before, after = (sum(value for (_, on), value in least.items() if on == which) for which in (False, True))
    print(f"sum        {before:8.2f} {after:9.2f}   the ground adds {after - before:.2f}")


def write(folder: Path, on: bool) -> Path:
    """The embedded job with the shot's true materials, with a ground or without."""
    job = yaml.safe_load((SHOT / "shot.yaml").read_text())
    job |= {"decompose": {"path": "truth/material.####.exr"}, "output": f"out-{on}"}
    job = {key: value for key, value in job.items() if key not in {"capture", "evidence"} and (on or key != "set")}
    file = folder / f"ground-{on}.yaml"
    file.write_text(yaml.safe_dump(job))
    return file


def seconds(session: Session, stage: Any, task: Any, frame: int) -> float:
    """Processor seconds of one task."""
    space = Uncommitted(session.job, session.graph().committer(stage, frame))
    start = time.process_time()
    task(space)
    return time.process_time() - start


if __name__ == "__main__":
    main()
