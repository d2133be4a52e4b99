"""Finds and runs Blender and anny, which have Python environments of their own."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.errors import JobError, MissingPartError, YesntError

_HERE = Path(__file__).resolve().parent
BLENDER_VARIABLE = "YESNT_BLENDER"
ANNY_VARIABLE = "YESNT_ANNY"
DEFAULT_BLENDER = ".venv-blender/bin/python"
DEFAULT_ANNY = ".venv-anny/bin/python"
REPORTED = "yesnt-error "
"""Begins the line of stderr in which a script inside Blender reports a mistake of the user's files."""


@dataclass(frozen=True)
class Tools:
    """Programs that the capture stage runs, and the folder of its fetched files.

    Attributes:
        blender: a Python that has `bpy`, or a Blender program.
        anny: a Python that has `anny`; None where no human is asked for.
        cache: folder of fetched assets and rest bodies; its files may be deleted at any time.
        threads: of each Blender.
        niceness: added to Blender's scheduling priority.
    """

    blender: str
    anny: str | None
    cache: str
    threads: int = 1
    niceness: int = 0


OLDEST = (4, 2)
"""The oldest Blender that the virtual stage's scripts run in; scenes of users are rendered by older ones too."""


def stage_tools(cache: Path, threads: int = 1, niceness: int = 0) -> Tools:
    """As `find_tools`, for rendering the virtual stage.

    Raises:
        MissingPartError: there is no Blender, or it is too old.
    """
    tools = find_tools(cache, threads, niceness)
    if not _is_python(tools):
        told = re.search(r"Blender (\d+)\.(\d+)", _run([tools.blender, "--version"], "Blender", 0, 60.0))
        if told is not None and tuple(map(int, told.groups())) < OLDEST:
            raise MissingPartError(
                f"This Blender is too old for the virtual stage: {told.group()}",
                tools.blender,
                f"Blender {OLDEST[0]}.{OLDEST[1]} or newer, or a Python that has bpy",
                f"run `make blender`, or set {BLENDER_VARIABLE} to yours",
            )
    return tools


def find_tools(cache: Path, threads: int = 1, niceness: int = 0) -> Tools:
    """Blender from YESNT_BLENDER, else `.venv-blender` in the current folder, else `blender` on the path.

    Raises:
        MissingPartError: there is none of them.
    """
    blender = os.environ.get(BLENDER_VARIABLE) or _first(DEFAULT_BLENDER) or shutil.which("blender")
    if not blender or not shutil.which(blender):
        raise MissingPartError(
            "Blender is not here",
            blender or f"{BLENDER_VARIABLE}, {DEFAULT_BLENDER}, blender on the path",
            "a Blender from 4.2, or a Python that has bpy",
            f"run `make blender`, or set {BLENDER_VARIABLE} to yours",
        )
    return Tools(blender, _find_anny(), str(cache), threads, niceness)


def anny_only(cache: Path) -> Tools:
    """Tools for what needs rest bodies and no Blender."""
    return Tools("", _find_anny(), str(cache))


def _find_anny() -> str | None:
    return os.environ.get(ANNY_VARIABLE) or _first(DEFAULT_ANNY)


def run_blender(tools: Tools, request: Mapping[str, Any], work: Path, timeout: float = 3600.0) -> None:
    """Runs `inside_blender/main.py` on a request; what it writes is whole or absent.

    Raises:
        YesntError: Blender ended in an error; the message holds the last lines of its log.
    """
    asked = work / "request.json"
    asked.write_text(json.dumps(request, sort_keys=True))
    run_script(tools, _HERE / "inside_blender" / "main.py", [str(asked)], timeout)


def run_script(tools: Tools, script: Path, arguments: Sequence[str], timeout: float) -> None:
    """Runs a script inside Blender.

    Raises:
        YesntError: Blender ended in an error; the message holds the last lines of its log.
    """
    # A Blender program ends with status 0 after an error of a script unless told otherwise; the user's own start-up
    # file, preferences and add-ons are left out, and a scene's own scripts do not run.
    program = [tools.blender, "--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1"]
    head = [tools.blender, str(script)] if _is_python(tools) else [*program, "--python", str(script), "--"]
    _run([*head, *arguments], "Blender", tools.niceness, timeout)


def run_anny(tools: Tools, requests: Sequence[Mapping[str, Any]], work: Path, timeout: float = 1800.0) -> None:
    """Runs `inside_anny/dump_body.py`.

    Raises:
        MissingPartError: there is no Python that has anny.
        YesntError: it ended in an error.
    """
    if tools.anny is None:
        raise MissingPartError(
            "The parametric human `anny` is not here",
            f"{ANNY_VARIABLE}, {DEFAULT_ANNY}",
            "a Python that has anny",
            f"run `make blender`, or set {ANNY_VARIABLE}",
        )
    asked = work / "bodies.json"
    asked.write_text(json.dumps(list(requests), sort_keys=True))
    _run([tools.anny, str(_HERE / "inside_anny" / "dump_body.py"), str(asked)], "anny", tools.niceness, timeout)


def blender_maps(tools: Tools) -> Path:
    """The folder of the HDR maps that come inside Blender."""
    expression = "import bpy; print('maps at', bpy.utils.system_resource('DATAFILES', path='studiolights/world'))"
    flag = ["-c"] if _is_python(tools) else ["--background", "--python-expr"]
    log = _run([tools.blender, *flag, expression], "Blender", 0, 300.0)
    found = [line.removeprefix("maps at ") for line in log.splitlines() if line.startswith("maps at ")]
    if not found or not Path(found[0]).is_dir():
        raise MissingPartError(
            "This Blender has no HDR maps", tools.blender, "studiolights/world", "run `make blender`"
        )
    return Path(found[0])


def _is_python(tools: Tools) -> bool:
    return Path(tools.blender).name.startswith("python")


def _run(command: Sequence[str], name: str, niceness: int, timeout: float) -> str:
    environment = {**os.environ, "PYTHONNOUSERSITE": "1"}
    nice = ["nice", "-n", str(niceness)] if niceness else []
    try:
        done = subprocess.run(
            [*nice, *command], env=environment, capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise YesntError(f"{name} ran longer than {timeout:.0f} s", " ".join(command), "", "try again") from error
    if done.returncode:
        _refuse_reported(done.stderr)
        tail = " | ".join((done.stderr or done.stdout).strip().splitlines()[-4:])
        raise YesntError(
            f"{name} ended with status {done.returncode}: {tail}", " ".join(command), "", "see its message"
        )
    return done.stdout


def _refuse_reported(stderr: str) -> None:
    """Raises the error that a script reports as a line of JSON: what, where, expected, do."""
    found = [line.removeprefix(REPORTED) for line in stderr.splitlines() if line.startswith(REPORTED)]
    if found:
        raise JobError(*json.loads(found[-1]))


def _first(path: str) -> str | None:
    return str(Path(path).absolute()) if Path(path).exists() else None
