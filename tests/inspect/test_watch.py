"""`status --watch`: another process follows a run by its records and its event log."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console

from tests.tiny_shot import write_tiny_shot
from yesnt.cli.watch import draw
from yesnt.inspect.watch import EventLog, Watch
from yesnt.io.records import Record
from yesnt.planning.frame_grid import DONE, NONE, RUNNING, WAITING
from yesnt.planning.stages import FLOW
from yesnt.runtime.session import Session


def write(log: Path, *events: dict[str, object]) -> None:
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as stream:
        stream.writelines(json.dumps(event) + "\n" for event in events)


def test_the_log_is_read_from_its_present_end_line_by_line(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    write(path, {"event": "old"})
    log = EventLog(path)
    assert list(log.read()) == []
    write(path, {"event": "new"})
    with path.open("a") as stream:
        stream.write('{"event": "ha')
    assert list(log.read()) == [{"event": "new"}]
    with path.open("a") as stream:
        stream.write('lf"}\n')
    assert list(log.read()) == [{"event": "half"}]
    path.write_text('{"event": "anew"}\n')
    assert list(log.read()) == [{"event": "anew"}]


def test_records_then_events(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 2))
    node = session.graph().committer(FLOW, 1001)
    session.book.commit(Record("flow", 1001, node.frame_key(1001), node.fields))
    watch = Watch(tmp_path / "shot")
    assert watch.grid.states("flow").tolist() == [DONE, NONE]
    write(session.output.events, {"event": "start", "stage": "relight", "frames": [1002]})
    assert watch.update()
    assert watch.grid.states("relight").tolist() == [WAITING, RUNNING]
    assert not watch.update()
    session.book.forget(FLOW, 1001)
    write(session.output.events, {"event": "plan", "stages": {}, "reused": {}})
    assert watch.update()
    assert watch.grid.states("flow").tolist() == [WAITING, NONE]


def test_the_terminal_shows_stages_rates_and_lost_frames(tmp_path: Path) -> None:
    watch = Watch(write_tiny_shot(tmp_path / "shot", 2))
    facts = {"stage": "relight", "frames": [1001]}
    for event in ({"event": "start"}, {"event": "done", "seconds": 1.5}):
        watch.grid.apply({**facts, **event})
    facts["frames"] = [1002]
    for event in ({"event": "start"}, {"event": "dead", "reason": "its worker died 2 times"}, {"event": "start"}):
        watch.grid.apply({**facts, **event})
    console = Console(record=True, width=120)
    console.print(draw(watch.grid))
    text = console.export_text()
    assert "relight     ■■                     1 of 2  1.5 s" in text
    assert "relight 1002: its worker died 2 times" in text
    assert "2 frames, about" in text
