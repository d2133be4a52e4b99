"""The report of a run is one self-contained page, with what there is and without what there is not."""

from __future__ import annotations

import json
from pathlib import Path

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.io.records import Record
from yesnt.planning.stages import RELIGHT
from yesnt.report import write_report
from yesnt.runtime.driver.attempt import recorded
from yesnt.runtime.session import Session

DECOMPOSE = {"backend": "embedded", "samples": 2, "knobs": {"keyframe_step": 3, "steps": 1}}


def test_a_finished_shot_shows_where_evaluations_went_and_the_measured_curve(tmp_path: Path) -> None:
    session = run_here(write_tiny_shot(tmp_path / "shot", 3, decompose=DECOMPOSE), until="composite")
    page = write_report(session).read_text()
    assert "Where network evaluations went" in page
    assert "Speed against accuracy" not in page
    assert "Materials measured by the capture" not in page
    assert "src=" in page
    assert all(part.startswith("data:image/png") for part in page.split('src="')[1:]), "nothing is fetched"
    facts = json.loads((session.output.run / "report.json").read_text())
    assert facts["sampling"]["total"] == sum(
        session.book.find("decompose", frame).facts["nfe"] for frame in session.job.frames
    )
    (session.output.run / "trade.json").write_text("{}")
    (session.output.run / "trade.svg").write_text("<svg id='curve'></svg>")
    page = write_report(session).read_text()
    assert "Speed against accuracy" in page
    assert "<svg id='curve'>" in page


def test_a_shot_that_was_not_run_has_a_page_that_says_so(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 2))
    session.output.run.mkdir(parents=True)
    page = write_report(session).read_text()
    assert "Not done" in page
    assert "Where network evaluations went" not in page


def test_a_task_whose_receipt_was_lost_is_in_the_timeline(tmp_path: Path) -> None:
    """Its worker or the scheduler died after it had committed: what its record says is all that is known."""
    session = Session(write_tiny_shot(tmp_path / "shot", 2))
    session.output.run.mkdir(parents=True)
    node = session.graph().committer(RELIGHT, 1001)
    measured = {"seconds": {"task": 1.5, "kernel": 1.0}, "facts": {"peak_bytes": 1}}
    session.book.commit(Record("relight", 1001, node.frame_key(1001), node.fields, **measured))
    event = {"event": "done", "time": 10.0, "stage": "relight", "frames": [1001], **recorded(session.book, node)}
    session.output.events.write_text(json.dumps(event) + "\n")
    write_report(session)
    (task,) = json.loads((session.output.run / "report.json").read_text())["tasks"]
    assert (task["stage"], task["worker"], task["begin"], task["end"]) == ("relight", 0, 8.5, 10.0)
