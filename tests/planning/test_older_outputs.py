"""An output folder that an older version made is said to be that, made anew, and left without the old names."""

from __future__ import annotations

import json
from pathlib import Path

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.inspect.frame_states import states
from yesnt.inspect.verify import verify
from yesnt.planning.stages import DECOMPOSE, STAGES
from yesnt.report.facts import gather
from yesnt.report.timeline import timeline_svg
from yesnt.runtime.session import Session
from yesnt.runtime.sweep import sweep_transients


def age(session: Session) -> None:
    """Makes the output look as the version before left it: stage `trust`, array `evaluations`, lower versions."""
    records = session.book.folder
    (records / "confidence").rename(records / "trust")
    for path in (records / "trust").glob("*.json"):
        document = json.loads(path.read_text()) | {"stage": "trust"}
        del document["check"]  # older records have none
        path.write_text(json.dumps(document))
    (session.output.store / "evaluations").mkdir()
    for path in (records / "decompose").glob("*.json"):
        document = json.loads(path.read_text())
        del document["check"]  # older records have none
        document["fields"]["version"] -= 1
        document["key"] = "0" * 32
        path.write_text(json.dumps(document))


def test_records_of_an_older_version_are_stale_and_say_so(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 2)
    age(run_here(path, "solve"))
    found = {(s.stage, s.frame): s for s in states(Session(path))}
    old = found["confidence", 1001]
    assert (old.state, old.why) == ("stale", "an older version of yesnt made it, as stage 'trust'")
    version = found["decompose", 1002]
    assert version.state == "stale"
    assert not verify(Session(path)), "a record of another version is stale, not damaged"
    now = STAGES["decompose"].version
    assert version.why == f"another version of yesnt made it: the stage's version was {now - 1}, is {now}"


def test_marks_and_events_of_an_older_version_are_read(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 2))
    for stage in ("trust", "decompose"):
        mark = session.output.dead / stage / "1001.json"
        mark.parent.mkdir(parents=True)
        mark.write_text(json.dumps({"stage": stage, "frame": 1001, "reason": "it killed two workers"}))
    assert session.marked_dead() == {(DECOMPOSE, 1001): "it killed two workers"}
    facts = {"event": "done", "time": 9.0, "frames": [1001], "pid": 1, "seconds": 2.0}
    stages = ("trust", "preview.reel", "solve.0.r3", "polish")
    session.output.events.write_text("\n".join(json.dumps({**facts, "stage": stage}) for stage in stages))
    tasks = gather(session)["tasks"]
    assert [task["stage"] for task in tasks] == ["confidence", "preview", "solve"]
    assert timeline_svg(tasks).count("<title>") == 3


def test_what_older_versions_left_under_other_names_is_removed_after_a_run(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 2)
    age(run_here(path, "solve"))
    session = run_here(path, "solve")
    assert {s.state for s in states(session) if s.stage in ("decompose", "confidence", "solve")} == {"done"}
    sweep_transients(session.graph(), session.book, session.output)
    assert not (session.book.folder / "trust").exists()
    assert not (session.output.store / "evaluations").exists()
