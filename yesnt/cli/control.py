"""Verbs that hand a run over and look after it: submit, export-openjd, logs, pause, resume, cancel, skip."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from yesnt.cli import text

ShotArgument = Annotated[Path, typer.Argument(metavar="SHOT", help="shot.yaml or its folder")]
JsonOption = Annotated[bool, typer.Option("--json", help="one JSON document on stdout")]

FOLLOW_SECONDS = 0.5


def submit(
    shot: ShotArgument,
    cluster: Annotated[str, typer.Option(help="local, slurm, a profile (farm.yaml), or a scheduler's address")],
    workers: Annotated[int | None, typer.Option(min=1, max=10_000, help="CPU workers [2, or the profile's]")] = None,
    insecure: Annotated[bool, typer.Option("--insecure", help="allow plain TCP to a scheduler elsewhere")] = False,
    frames: Annotated[str | None, typer.Option(help="frames, as 1001-1010x2,1020; 1-100:10: every tenth first")] = None,
    until: Annotated[str | None, typer.Option(metavar="STAGE", help="stop after this stage")] = None,
    force: Annotated[list[str] | None, typer.Option(metavar="STAGE[:F]", help="make these again")] = None,
    priority: Annotated[int, typer.Option(help="among the runs of one scheduler; higher goes first")] = 0,
    accept_license: Annotated[list[str] | None, typer.Option(metavar="NAME", help="a non-commercial licence")] = None,
    json: JsonOption = False,
) -> None:
    """Hand a run to a cluster and return at once; status, logs, pause, resume, cancel, skip look after it."""
    from yesnt.runtime.control.submit import SubmitOptions, submit_run

    options = SubmitOptions(
        cluster, workers, insecure, frames, until, tuple(force or ()), priority, tuple(accept_license or ())
    )
    made = submit_run(shot, options)
    if json:
        text.print_json({"submission": made.id, "job": made.job, "cluster": made.cluster})
    else:
        print(f"Submitted {made.id} ({made.job})")
        print(f"Follow it with `yesnt status {shot}` or `yesnt logs {shot} --follow`.")


def export_openjd(
    shot: ShotArgument,
    output: Annotated[Path | None, typer.Option(help="file to write; absent: stdout")] = None,
    chunk: Annotated[int, typer.Option(min=1, help="frames of a task")] = 10,
    json: Annotated[bool, typer.Option("--json", help="JSON instead of YAML")] = False,
) -> None:
    """Write an Open Job Description template: a farm runs ranges of frames side by side."""
    import yaml

    from yesnt.io.durable import write_bytes
    from yesnt.io.jobfile import parse_frames
    from yesnt.runtime.control.commands import open_output
    from yesnt.runtime.control.open_job import open_job_template

    job, _ = open_output(shot)
    file = shot.absolute() / "shot.yaml" if shot.is_dir() else shot.absolute()
    template = open_job_template(job.name, file, parse_frames(job.frames, "key frames"), chunk)
    if output is None and json:
        text.print_json(template)
        return
    written = text.json_text(template) if json else yaml.safe_dump(template, sort_keys=False, allow_unicode=True)
    if output is None:
        print(written, end="")
    else:
        write_bytes(output, written.encode())
        print(f"Wrote {output}: hand it to the farm, for example `openjd run {output} --step Check`.")


def pause(shot: ShotArgument, json: JsonOption = False) -> None:
    """Let tasks under way end and start no others until `resume`."""
    _ask(shot, "pause", json, "tasks under way end, no others start until `yesnt resume`")


def resume(shot: ShotArgument, json: JsonOption = False) -> None:
    """Go on with a paused run."""
    _ask(shot, "resume", json, "the run goes on")


def cancel(shot: ShotArgument, json: JsonOption = False) -> None:
    """End a run; what is committed stays, and `run` or `submit` goes on from it."""
    _ask(shot, "cancel", json, "the driver ends within seconds; what is committed stays")


def skip(
    shot: ShotArgument,
    frames: Annotated[str, typer.Option(help="frames, as 1001-1010x2,1020")],
    stage: Annotated[str, typer.Option(help="decompose, flow, relight or composite")] = "relight",
    json: JsonOption = False,
) -> None:
    """Leave frames of a stage out so that all others finish; `retry` takes them in again."""
    from yesnt.core.frame_ranges import frame_ranges
    from yesnt.runtime.control.commands import skip as leave_out

    run, chosen = leave_out(shot, frames, stage)
    if json:
        text.print_json({"stage": stage, "frames": frame_ranges(chosen), "run": run.run if run.active else ""})
    else:
        when = "the driver leaves them out" if run.active else "the next run leaves them out"
        print(
            f"Skipped: {stage} {frame_ranges(chosen)}; {when}. `yesnt retry {shot} --frames ...` takes them in again."
        )


def logs(
    shot: ShotArgument,
    frame: Annotated[int | None, typer.Option(help="logs of this frame's tasks instead of the driver's")] = None,
    stage: Annotated[str | None, typer.Option(metavar="STAGE", help="of this stage only")] = None,
    follow: Annotated[bool, typer.Option("--follow", help="print what is added until the run is over")] = False,
) -> None:
    """Print what the driver of the last run printed, or the logs of a frame."""
    from yesnt.core.errors import JobError
    from yesnt.inspect.logs import RunLines, frame_logs
    from yesnt.inspect.run_view import look
    from yesnt.runtime.control.commands import open_output

    _, output = open_output(shot)
    if frame is not None:
        print("\n".join(frame_logs(output, frame, stage)))
        return
    if look(output, 0).state == "none":
        raise JobError("No run of this job has begun", str(output.run), "a run", "`yesnt run SHOT` starts one")
    lines = RunLines(output, stage)
    while True:
        over = not follow or look(output, 0).over
        for line in lines.fresh():
            print(line)
        sys.stdout.flush()
        if over:
            return
        time.sleep(FOLLOW_SECONDS)


def _ask(shot: Path, verb: str, json: bool, effect: str) -> None:
    from yesnt.runtime.control.commands import ask

    run = ask(shot, verb)
    if json:
        text.print_json({"asked": verb, "run": run.run, "state": run.state})
        return
    where = f"the driver on {run.host}, pid {run.pid}" if run.host else f"submission {run.submission}, not begun yet"
    print(f"Asked {where} to {verb}: {effect}.")
    if run.state == "silent":
        print("That driver gives no sign of life at the moment; `yesnt run` takes over if it stays so for 30 s.")


def note_submission_end(status: int) -> None:
    """The driver of a submission leaves its exit status, also when its run never began."""
    from contextlib import suppress

    from yesnt.core.errors import YesntError
    from yesnt.runtime.control.commands import open_output
    from yesnt.runtime.control.submission import note_end

    with suppress(YesntError, OSError, IndexError):
        note_end(open_output(Path(sys.argv[2]))[1], status)
