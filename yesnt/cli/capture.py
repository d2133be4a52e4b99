"""`yesnt capture`: checks the cameras, mattes, time and gains of a capture before anything is fitted."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from yesnt.cli import text


def capture(
    shot: Annotated[Path, typer.Argument(metavar="SHOT", help="shot.yaml or its folder")],
    frame: Annotated[int | None, typer.Option(help="frame that is looked at; default: the first")] = None,
    sync: Annotated[int, typer.Option(min=0, max=32, help="largest offset in time that is tried, frames")] = 0,
    json: Annotated[bool, typer.Option("--json", help="one JSON document on stdout")] = False,
) -> int:
    """Check a capture: units, overlap, order, mirrored cameras, mattes, time, gains."""
    from yesnt.capture.report import report_capture
    from yesnt.runtime.awaited import refuse_without_mattes
    from yesnt.runtime.session import Session

    session = Session(shot)
    refuse_without_mattes(session.resolved.awaiting, session.output.root)
    job = session.job
    found = report_capture(job, job.frames[0] if frame is None else frame, sync)
    if json:
        text.print_json(asdict(found))
        return 1 if found.problems else 0
    rows = [("cameras", str(found.cameras))]
    if found.subject is not None:
        rows.append(("subject", " x ".join(f"{side:.3f}" for side in found.subject) + " m"))
    rows += [(f"gain of {name}", ", ".join(f"{v:.3f}" for v in gain)) for name, gain in found.gains.items()]
    rows += [(f"{name} is late by", f"{late} frames") for name, late in found.offsets.items()]
    text.print_table(("capture", ""), rows)
    for problem in found.problems:
        print(f"Problem: {problem}")
    return 1 if found.problems else 0
