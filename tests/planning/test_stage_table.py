"""The stage table is the one place that knows of a stage: a new row, record, builder and function are a new stage."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from tests.in_process import run_here
from tests.planning.long_shot import long_plan
from tests.planning.toy_stage import ROW, TOY, shot_graph_with_toy
from tests.tiny_shot import write_tiny_shot
from yesnt.core.stage_id import StageId
from yesnt.inspect.forecast import forecast
from yesnt.inspect.frame_states import states
from yesnt.inspect.verify import verify
from yesnt.io.store import FrameStore
from yesnt.planning.stages import SOLVE, STAGES, function_of
from yesnt.planning.task_records import TaskRecord
from yesnt.report.timeline import timeline_svg
from yesnt.runtime.cluster.worker_settings import dask_settings
from yesnt.runtime.session import Session
from yesnt.workflows.shot import shot_graph


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STAGES, ROW.name, ROW)
    monkeypatch.setattr("yesnt.runtime.session.shot_graph", shot_graph_with_toy)


def test_a_new_stage_runs_to_a_committed_record(toy: None, tmp_path: Path) -> None:
    session = run_here(write_tiny_shot(tmp_path / "shot", 2), until="toy")
    record = session.book.find(TOY, 1002)
    assert record is not None
    assert record.facts["factor"] == 2
    material, z = (FrameStore(session.output.store).read(name, 1) for name in ("material", "z"))
    np.testing.assert_array_equal(z, 2 * material[:1])
    assert {s.state for s in states(session) if s.stage == "toy"} == {"done"}
    assert not verify(session)
    session.book.forget(TOY, 1001)
    assert [s.frame for s in states(session) if s.stage == "toy" and s.state == "waiting"] == [1001]


def test_a_new_stage_is_forecast_drawn_and_scheduled_from_its_row(toy: None, tmp_path: Path) -> None:
    rows = {row.stage: row for row in forecast(Session(write_tiny_shot(tmp_path / "shot", 2))).stages}
    assert rows["toy"].todo == 2
    assert rows["toy"].peak_bytes == pytest.approx(100e6, rel=0.01)
    bar = timeline_svg([{"stage": "toy", "frame": 1001, "worker": 1, "begin": 0.0, "end": 1.0}])
    assert bar.count(ROW.color) == 2, "its bar and its place in the legend"
    assert dask_settings()["distributed.scheduler.default-task-durations"]["toy"] == "3s"


def test_every_task_of_the_table_has_a_function() -> None:
    for row in STAGES.values():
        assert row.channels or row.files, f"{row.name} writes nothing"
        for target in row.tasks.values():
            module, name = target.split(":")
            assert callable(getattr(importlib.import_module(module), name)), target


def test_a_task_is_run_by_the_function_of_its_own_stage() -> None:
    for node in shot_graph(long_plan(4, chunk=2)):
        assert function_of(node.stage, node.task).startswith("yesnt.tasks.")
    with pytest.raises(KeyError):
        function_of(SOLVE, TaskRecord())


@pytest.mark.parametrize(
    ("stage", "label"),
    [
        (StageId("solve"), "solve"),
        (StageId("solve", 0), "solve.sweep0"),
        (StageId("solve", 12, 3), "solve.sweep12.band3"),
        (StageId("window", lane=1), "window.lane1"),
        (StageId("preview", part="segment"), "preview.segment"),
        (StageId("judge", part="sky.v2"), "judge.sky.v2"),
    ],
)
def test_a_stage_and_its_label_are_one(stage: StageId, label: str) -> None:
    assert str(stage) == stage.label == label
    assert StageId.parse(label) == stage
    assert hash(StageId.parse(label)) == hash(stage)
    assert stage.array("material") == ("material" if stage == SOLVE else f"{label}.material")


def test_no_label_is_refused() -> None:
    with pytest.raises(ValueError, match="'' is no label of a stage"):
        StageId.parse("")
