"""Looks after a run from any machine that sees its output: pause, resume, cancel, skip."""

from __future__ import annotations

from pathlib import Path

from yesnt.core.errors import JobError, UsageError
from yesnt.core.shot import Shot
from yesnt.core.stage_id import StageId
from yesnt.inspect.run_view import RunView, look
from yesnt.io.commands import Command, own_name, send_command
from yesnt.io.dead_marks import SKIPPED, DeadMarks
from yesnt.io.jobfile import load_shot, parse_frames
from yesnt.io.output import OutputFolder

SKIPPABLE = ("decompose", "flow", "relight", "composite")
"""Stages whose tasks are a frame each: one can be left out without the others."""


def open_output(path: Path) -> tuple[Shot, OutputFolder]:
    """The job and its output folder; the inputs are not looked at.

    Raises:
        JobError: the job file is wrong.
    """
    file = path.absolute()
    file = file / "shot.yaml" if file.is_dir() else file
    shot = load_shot(file)
    return shot, OutputFolder.under(file.parent, shot.output)


def ask(path: Path, verb: str) -> RunView:
    """Leaves a command for the driver, or for the submission that has not begun; returns the run that it is for.

    Raises:
        JobError: no run is under way.
    """
    _, output = open_output(path)
    run = look(output)
    if run.over:
        raise JobError(
            f"No run of this job is under way (the last one: {run.state})", str(output.run), "a run to " + verb,
            "`yesnt run` or `yesnt submit` starts one",
        )  # fmt: skip
    send_command(output.commands, Command(verb, run.run, own_name()))
    return run


def skip(path: Path, frames: str, stage: str) -> tuple[RunView, tuple[int, ...]]:
    """Leaves frames of a stage out: the driver gives them up, or they are marked for the next run.

    Raises:
        UsageError: a stage whose tasks hold several frames, or frames that the shot has not.
    """
    if stage not in SKIPPABLE:
        raise UsageError(f"Stage {stage!r} cannot be skipped", "--stage", f"one of {', '.join(SKIPPABLE)}", "name one")
    shot, output = open_output(path)
    chosen = parse_frames(frames, "--frames")
    unknown = sorted(set(chosen) - set(parse_frames(shot.frames, "key frames")))
    if unknown:
        raise UsageError(f"The shot has no frame {unknown[0]}", "--frames", shot.frames, "choose among these")
    run, by = look(output), own_name()
    if run.active:
        send_command(output.commands, Command("skip", run.run, by, stage, chosen))
    else:
        with output.lock():
            DeadMarks(output.dead).set(StageId(stage), chosen, f"{SKIPPED} by {by}")
    return run, chosen
