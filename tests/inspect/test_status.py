"""`status`, `plan` and `explain`: causes once, frames as ranges, delivered files looked at, the last answer reused."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.in_process import run_here
from tests.long_shot import pretend_done, write_long_shot
from tests.tiny_shot import write_tiny_shot
from yesnt.cli.text import print_status
from yesnt.inspect.explain import explain
from yesnt.inspect.forecast import forecast
from yesnt.inspect.frame_states import states
from yesnt.inspect.status import StatusReport, status
from yesnt.inspect.status_memory import StatusMemory
from yesnt.io import file_digests
from yesnt.planning.stages import RELIGHT
from yesnt.runtime.driver.driver import is_done
from yesnt.runtime.session import Session

LONG = 300


@pytest.fixture(autouse=True)
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files count as old enough to be remembered."""
    monkeypatch.setattr(file_digests, "SETTLED_SECONDS", -1.0)
    monkeypatch.setattr("yesnt.inspect.status_memory.SETTLED_SECONDS", -1.0)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = write_tiny_shot(tmp_path_factory.mktemp("finished") / "shot", 3, (24, 20))
    run_here(path, "preview")
    return path


@pytest.fixture
def shot(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished.parent, tmp_path / "shot")
    return tmp_path / "shot" / "shot.yaml"


@pytest.fixture(scope="module")
def long_shot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = write_long_shot(tmp_path_factory.mktemp("long") / "shot", LONG)
    pretend_done(path)
    return path


def exr(shot: Path, frame: int) -> Path:
    return shot.parent / "out" / "exr" / f"tiny.{frame}.exr"


def change(shot: Path, old: str, new: str) -> None:
    text = shot.read_text()
    assert old in text
    shot.write_text(text.replace(old, new, 1))


def not_done(shot: Path) -> dict[tuple[str, int], str]:
    return {(s.stage, s.frame): s.why for s in states(Session(shot)) if s.state != "done"}


def test_a_deleted_exr_is_noticed_by_everything_and_made_again(shot: Path) -> None:
    before = exr(shot, 1002).read_bytes()
    exr(shot, 1002).unlink()
    assert not_done(shot) == {("composite", 1002): "exr/tiny.####.exr is missing"}
    assert {g.frames for g in status(shot).groups if g.state == "stale"} == {"1002"}
    assert {s.stage: s.why for s in explain(Session(shot), 1002)}["composite"] == "exr/tiny.####.exr is missing"
    assert {row.stage: row.todo for row in forecast(Session(shot)).stages if row.todo} == {"composite": 1}
    session = Session(shot)
    todo = [node.frames for node in session.graph() if not is_done(session.book, node) and not node.transient]
    assert todo == [(1002,)]
    run_here(shot, "composite")
    assert exr(shot, 1002).read_bytes() == before
    assert not_done(shot) == {}


def test_a_replaced_exr_is_noticed_and_a_copied_one_is_not(shot: Path) -> None:
    data = exr(shot, 1001).read_bytes()
    exr(shot, 1003).write_bytes(data)
    os.utime(exr(shot, 1002))
    assert not_done(shot) == {("composite", 1003): "exr/tiny.####.exr is not the file that was committed"}
    run_here(shot, "composite")
    assert not_done(shot) == {}
    assert exr(shot, 1003).read_bytes() != data


def test_one_changed_setting_is_one_line_with_old_and_new_value(
    long_shot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = long_shot.read_text()
    try:
        change(long_shot, "texels: 8", "texels: 9")
        report = status(long_shot)
    finally:
        long_shot.write_text(text)
    print_status(report)
    out = capsys.readouterr().out
    assert f"stale: relight.texels was 8, is 9: relight 1001-{1000 + LONG}\n" in out
    assert f"stale: follows from relight: composite 1001-{1000 + LONG}\n" in out
    assert len(out) < 1000
    document = json.dumps(report.as_json())
    assert len(document) < 4000
    for printed in (out, document):
        assert not re.search("[0-9a-f]{32}", printed)


def test_json_names_every_frame_and_is_read_back(shot: Path) -> None:
    exr(shot, 1002).unlink()
    report = status(shot)
    assert StatusReport.from_json(json.loads(json.dumps(report.as_json()))) == report
    composite = {group.state: group.frames for group in report.groups if group.stage == "composite"}
    assert composite == {"done": "1001,1003", "stale": "1002"}
    assert report.counts["composite"] == {"done": 2, "stale": 1, "waiting": 0, "dead": 0}


def test_an_unchanged_shot_is_not_planned_again(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = status(shot)
    monkeypatch.setattr("yesnt.runtime.session.Session.__init__", lambda *a, **k: pytest.fail("it is planned again"))
    assert status(shot) == first
    assert status(shot.parent) == first


def delete(name: str) -> Callable[[Path], None]:
    return lambda shot: (shot.parent / name).unlink()


def mark_dead(shot: Path) -> None:
    session = Session(shot)
    session.dead_marks.set(RELIGHT, [session.job.frames[0]], "it killed two workers")


CHANGES: dict[str, Callable[[Path], None]] = {
    "a plate": lambda shot: shutil.copy(shot.parent / "plate.1001.exr", shot.parent / "plate.1002.exr"),
    "the job": lambda shot: change(shot, "texels: 8", "texels: 9"),
    "a delivered file": delete("out/exr/tiny.1002.exr"),
    "a record": delete("out/run/records/relight/1002.json"),
    "a mark of death": mark_dead,
    "the video": delete("out/run/preview.mp4"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_any_change_is_seen(shot: Path, name: str) -> None:
    status(shot)
    assert StatusMemory.of(shot).recall() is not None
    CHANGES[name](shot)
    assert StatusMemory.of(shot).recall() is None
    assert {group.state for group in status(shot).groups} > {"done"}


@pytest.mark.parametrize("name", ["status.json", "record_index.json", "file_digests.json", "facts.json"])
@pytest.mark.parametrize("text", ["", "[1]"])
def test_damaged_memories_are_ignored(shot: Path, name: str, text: str) -> None:
    expected, rows = status(shot), forecast(Session(shot)).stages
    (shot.parent / "out" / "run" / name).write_text(text)
    assert status(shot) == expected
    assert forecast(Session(shot)).stages == rows


def test_a_second_plan_decodes_nothing(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = forecast(Session(shot)).stages
    monkeypatch.setattr("yesnt.io.shot_inputs.read_passes", lambda *a: pytest.fail("a frame is decoded again"))
    monkeypatch.setattr("yesnt.runtime.checks.inputs.read_header", lambda *a: pytest.fail("a header is read again"))
    assert forecast(Session(shot)).stages == rows


def test_status_imports_nothing_heavy_where_nothing_changed() -> None:
    heavy = {"torch", "numba", "zarr", "distributed", "cv2", "numpy", "pydantic", "yesnt.runtime.session"}
    code = f"import sys, yesnt.inspect.status; print([m for m in {sorted(heavy)} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
