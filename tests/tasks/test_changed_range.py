"""A range of frames that is edited in the job file: what was computed stays, and is read at its new position."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tests.in_process import run_here
from yesnt.planning.stages import RELIGHT
from yesnt.runtime.driver.driver import is_done


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
    kept = [path for path in records if int(path.stem) in session.job.frames]
    assert len(kept) == 2
    assert all(path.stat().st_mtime_ns == records[path] for path in kept)


def test_frames_that_left_the_range_are_made_again_when_they_come_back(tiny_shot: Path) -> None:
    for frames in ("1001-1004", "1002-1003", "1001-1004"):
        set_frames(tiny_shot, frames)
        session = run_here(tiny_shot, until="relight")
    assert all(is_done(session.book, node) for node in session.graph() if node.stage == RELIGHT)
