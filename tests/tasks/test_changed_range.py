"""A range of frames that is edited in the job file: what was computed stays, and is read at its new position."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tests.in_process import run_here


def set_frames(job: Path, frames: str) -> None:
    document = yaml.safe_load(job.read_text())
    job.write_text(yaml.safe_dump(document | {"frames": frames}))


@pytest.mark.parametrize(("first", "then"), [("1002-1003", "1001-1004"), ("1001-1004", "1002-1003")])
def test_frames_keep_their_results(tiny_shot: Path, first: str, then: str) -> None:
    set_frames(tiny_shot, first)
    session = run_here(tiny_shot, until="relight")
    records = {path: path.stat().st_mtime_ns for path in (session.output.records / "decompose").glob("*.json")}
    materials = {f: session.book.find("decompose", f).arrays for f in session.job.frames}

    set_frames(tiny_shot, then)
    session = run_here(tiny_shot, until="relight")
    for frame in session.job.frames:
        record = session.book.find("decompose", frame)
        assert record.arrays == materials.get(frame, record.arrays)
    assert records == {path: path.stat().st_mtime_ns for path in records}
