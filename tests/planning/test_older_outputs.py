"""An output folder that an older version made is said to be that, made anew, and left without the old names."""

from __future__ import annotations

import json
from pathlib import Path

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.inspect.audit import states
from yesnt.runtime.session import Session


def age(session: Session) -> None:
    """Makes the output look as the version before left it: stage `trust`, array `evaluations`, lower versions."""
    records = session.book.folder
    (records / "confidence").rename(records / "trust")
    (session.output.store / "evaluations").mkdir()
    for path in (records / "decompose").glob("*.json"):
        document = json.loads(path.read_text())
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
    assert version.why == "another version of yesnt made it: the stage's version was 3, is 4"


def test_what_older_versions_left_under_other_names_is_removed_after_a_run(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 2)
    age(run_here(path, "solve"))
    session = run_here(path, "solve")
    assert {s.state for s in states(session) if s.stage in ("decompose", "confidence", "solve")} == {"done"}
    session._sweep_transients()
    assert not (session.book.folder / "trust").exists()
    assert not (session.output.store / "evaluations").exists()
