"""A shot as an Open Job Description template (specification 2023-09), for farms that read it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from yesnt.core.frame_ranges import frame_ranges

MOST_TASKS = 1024
"""Values that the specification allows a task parameter."""

MOST_NAME = 128
"""Characters that the specification allows a job's name."""

FORMAT_VARIABLE, OPEN_JOB = "YESNT_PROGRESS", "openjd"
"""An environment variable of the template: progress and errors are printed as the specification wants them."""


def in_open_job() -> bool:
    """Whether a farm started this process by the template."""
    return os.environ.get(FORMAT_VARIABLE) == OPEN_JOB


def open_job_template(name: str, shot: Path, frames: tuple[int, ...], chunk: int) -> dict[str, Any]:
    """The template: inputs are checked, ranges of frames run side by side, then the preview is made.

    Args:
        name: of the shot.
        shot: absolute path of the job file; the farm's machines may be given another.
        frames: of the shot, ascending.
        chunk: frames of a task; more if there would be more than `MOST_TASKS` tasks.
    """
    size = max(chunk, -(-len(frames) // MOST_TASKS))
    ranges = [frame_ranges(frames[i : i + size]) for i in range(0, len(frames), size)]
    parameter = {"name": "Frames", "type": "STRING", "range": ranges}
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": name[:MOST_NAME],
        "parameterDefinitions": [
            {"name": "Shot", "type": "PATH", "objectType": "FILE", "dataFlow": "INOUT", "default": str(shot),
             "description": "The shot.yaml; its output folder must be on a disk that all machines share."},
        ],
        "jobEnvironments": [{"name": "Progress", "variables": {FORMAT_VARIABLE: OPEN_JOB}}],
        "steps": [
            _step("Check", ["plan", "{{Param.Shot}}"]),
            _step("Frames", ["run", "{{Param.Shot}}", "--share", "--frames", "{{Task.Param.Frames}}"], "Check")
            | {"parameterSpace": {"taskParameterDefinitions": [parameter]}},
            _step("Preview", ["run", "{{Param.Shot}}", "--share"], "Frames"),
        ],
    }  # fmt: skip


def _step(name: str, arguments: list[str], after: str = "") -> dict[str, Any]:
    script = {"actions": {"onRun": {"command": "yesnt", "args": arguments}}}
    return {"name": name, "script": script, **({"dependencies": [{"dependsOn": after}]} if after else {})}
