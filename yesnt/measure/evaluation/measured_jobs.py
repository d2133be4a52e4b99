"""Jobs that measure a shot's materials by its capture: one for each row, with an output of its own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import yaml

from yesnt.core.errors import UsageError
from yesnt.core.shot import Shot
from yesnt.io.cameras import read_cameras
from yesnt.io.durable import write_bytes
from yesnt.io.jobfile import load_shot, parse_frames
from yesnt.measure.evaluation.evidence_rows import MEASURED, InputErrors
from yesnt.measure.evaluation.fitted_rows import CAMERAS as FITTED_CAMERAS
from yesnt.measure.evaluation.spoilt_inputs import spoilt
from yesnt.measure.evaluation.subjects import Subject
from yesnt.runtime.session import Session

JOB = "measured.yaml"
"""Job file of a shot with a capture, if its `shot.yaml` has none."""


def measured_sessions(
    subject: Subject, home: Path, absolute: Callable[[Shot], dict[str, Any]], wanted: Collection[str] | None = None
) -> dict[str, Session]:
    """A session for every row whose cameras there are; none for a shot without a capture.

    Args:
        subject: the shot.
        home: folder of its evaluation.
        absolute: the shot with absolute paths, as a document.
        wanted: names of rows; None: all.

    Raises:
        UsageError: there is no such row.
    """
    for row in wanted or ():
        if row not in MEASURED:
            expected = f"{', '.join(MEASURED)}; or none"
            raise UsageError(
                f"No shot with a capture has the row {row!r}", "--capture-rows", expected, "check its spelling"
            )
    shot = load_shot(_job_file(subject))
    if shot.capture is None:
        return {}
    document, count = absolute(shot), len(read_cameras(subject.folder / shot.capture.cameras))
    sessions = {}
    for row, measured in MEASURED.items():
        if measured.cameras <= count and (wanted is None or row in wanted):
            evidence = {"use": True, "cameras": measured.cameras, "every": shot.evidence.every}
            folder = home / row
            folder.mkdir(parents=True, exist_ok=True)
            sections = _with_errors(document, measured.errors, folder)
            sessions[row] = open_session(folder, document | {"evidence": evidence} | sections)
    return sessions


def fitted_session(
    subject: Subject, home: Path, absolute: Callable[[Shot], dict[str, Any]], knobs: Mapping[str, Any]
) -> Session | None:
    """The shot as a job that has its capture alone: a field is fitted, rendered and meshed; None without a capture.

    Args:
        subject: the shot.
        home: folder of its evaluation.
        absolute: as in `measured_sessions`.
        knobs: of the fit.
    """
    shot = load_shot(_job_file(subject))
    if shot.capture is None:
        return None
    folder = home / "fitted"
    folder.mkdir(parents=True, exist_ok=True)
    document = {k: v for k, v in absolute(shot).items() if k not in ("plate", "matte", "gbuffer", "proxy")}
    evidence = {"use": True, "cameras": FITTED_CAMERAS, "every": shot.evidence.every}
    return open_session(folder, document | {"gaussians": {"knobs": dict(knobs)}, "evidence": evidence})


def _job_file(subject: Subject) -> Path:
    return next(path for path in (subject.folder / JOB, subject.folder / "shot.yaml") if path.is_file())


def _with_errors(document: Mapping[str, Any], errors: InputErrors, folder: Path) -> dict[str, Any]:
    if errors == InputErrors():
        return {}
    shot = Shot.model_validate(document)
    frames = parse_frames(shot.frames, str(folder))
    sections = spoilt(shot, errors, frames, folder)
    return {name: part.model_dump(mode="json", exclude_none=True) for name, part in sections.items()}


def open_session(home: Path, document: Mapping[str, Any]) -> Session:
    """Writes a job file to a folder and opens it."""
    text = "# Written by `yesnt eval`: the evaluated shot, its inputs by absolute paths.\n"
    write_bytes(home / "shot.yaml", (text + yaml.safe_dump(dict(document), sort_keys=True)).encode())
    return Session(home)
