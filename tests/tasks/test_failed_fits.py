"""A frame whose pictures cannot be fitted fails by itself; all other frames are delivered."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.runtime.fake_client import FakeClient
from tests.tasks.test_fit import KNOBS, SIDE, write_capture_shot
from yesnt.capture.usable import enough, fault_of
from yesnt.decompose.evidence.records import View
from yesnt.inspect.explain import explain
from yesnt.inspect.frame_states import DONE, WAITING, states
from yesnt.inspect.verify import verify
from yesnt.io.exr import read_planes, write_exr
from yesnt.planning.stages import FIT
from yesnt.report import write_report
from yesnt.runtime import session as session_module
from yesnt.runtime.control.share import run_shared
from yesnt.runtime.left_out import LeftOut, Missing, frames_before_gaps
from yesnt.runtime.run_options import RunOptions, RunResult
from yesnt.runtime.session import Session
from yesnt.tasks.fit import UNUSED

CHANGES: dict[str, Any] = {"gaussians": {"every": 3, "held_out": 1, "knobs": KNOBS | {"steps": 30, "check": 15}}}
LOST = (
    "Frame 1001 cannot be fitted: the pictures of only 4 of 8 cameras can be used. Where: capture, frame 1001: c00, "
    "c02, c03: its matte is empty; c01: its picture is black inside the matte. Expected: pictures and mattes of at "
    "least 67 % of the cameras. Do: mend these pictures or mattes and run again, or `yesnt skip SHOT --frames 1001 "
    "--stage fit`."
)


def spoil(folder: Path, camera: str, frame: int, channels: Iterable[str], value: float = 0.0) -> None:
    """Sets channels of a picture to a value."""
    path = folder / f"capture/{camera}/plate.{frame}.exr"
    planes = {name: plane.astype(np.float16) for name, plane in read_planes(path).items()}
    write_exr(path, planes | {name: np.full_like(planes[name], value) for name in channels})


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames that start from the first, which is spoiled in four of the eight that are fitted."""
    folder = tmp_path_factory.mktemp("failed")
    job = write_capture_shot(folder, 3, **CHANGES)
    for camera, channels in (("c00", "RGBA"), ("c01", "RGB"), ("c02", "A"), ("c03", "A")):
        spoil(folder, camera, 1001, channels)
    return job


class FakeCluster:
    """A cluster in this process."""

    def __init__(self, client: FakeClient, *args: Any) -> None:
        self.spec, self.dashboard, self._client = args[0], "", client

    def __enter__(self) -> FakeCluster:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def begin(self, listen: object) -> None:
        pass

    def client(self, *args: object) -> FakeClient:
        return self._client


@pytest.fixture(scope="module")
def ran(job: Path) -> tuple[RunResult, FakeClient]:
    with pytest.MonkeyPatch.context() as patch:
        client = FakeClient(patch)
        patch.setattr(session_module, "LazyCluster", lambda *args: FakeCluster(client, *args))
        return Session(job).run(RunOptions()), client


def test_other_frames_are_delivered_and_the_failure_is_named(job: Path, ran: tuple[RunResult, FakeClient]) -> None:
    result, session = ran[0], Session(job, as_run=True)
    assert [(str(stage), frame) for stage, frame in result.missing] == [("fit", 1001)]
    assert str(next(iter(result.missing.values()))).replace("\n", " ") == LOST
    assert session.job.frames == (1002, 1003)
    assert not session.resolved.awaiting
    assert session.output.exr_path("tiny", 1002).exists()
    assert session.output.exr_path("tiny", 1003).exists()
    assert not session.output.exr_path("tiny", 1001).exists()
    assert any(line.startswith("capture, frame 1001: its fit will fail") for line in result.warnings)


def test_followers_of_a_lost_keyframe_start_from_the_next_frame(job: Path, ran: tuple[RunResult, FakeClient]) -> None:
    graph = Session(job, as_run=True).graph()
    assert graph.committer(FIT, 1002).task.keyframe is None
    assert graph.committer(FIT, 1003).task.keyframe == 1002
    assert 1001 not in {frame for node in graph for frame in node.frames}


def test_the_others_are_as_in_a_job_without_the_frame(
    job: Path, ran: tuple[RunResult, FakeClient], tmp_path: Path
) -> None:
    alone = write_capture_shot(tmp_path, 3, **CHANGES)
    alone.write_text(alone.read_text().replace("1001-1003", "1002,1003"))
    assert not run_shared(Session(alone), RunOptions(until="view")).missing
    for name in ("field.1002.ply", "field.1003.ply", "view.1002.exr", "view.1003.exr"):
        assert (job.parent / f"out/gaussians/{name}").read_bytes() == (tmp_path / f"out/gaussians/{name}").read_bytes()


def test_verbs_that_look_show_what_is_done_and_what_failed(job: Path, ran: tuple[RunResult, FakeClient]) -> None:
    session = Session(job, as_run=True)
    found = states(session)
    assert {(one.stage, one.frame) for one in found if one.state != DONE} == {("fit", 1001)}
    (lost,) = explain(session, 1001)
    assert (lost.state, lost.why.replace("\n", " ")) == (WAITING, f"the last run went on without it: {LOST}")
    assert verify(session) == []
    assert "Frame 1001 cannot be fitted" in write_report(session).read_text()


def test_a_second_run_tries_it_again_and_makes_nothing_else(job: Path, ran: tuple[RunResult, FakeClient]) -> None:
    result = run_shared(Session(job, as_run=True), RunOptions())
    assert [frame for _, frame in result.missing] == [1001]
    assert {stage.name for stage, _ in result.outcome.done} <= {"preview"}  # a shared run keeps no segments
    assert LeftOut.read(Session(job).output.run).stages == {1001: "fit"}


def test_a_frame_with_few_lost_cameras_is_fitted_and_they_are_counted(tmp_path: Path) -> None:
    job = write_capture_shot(tmp_path, 1, **CHANGES)
    spoil(tmp_path, "c00", 1001, "A")
    spoil(tmp_path, "c01", 1001, "R", np.nan)
    assert not run_shared(Session(job), RunOptions(until="fit")).missing
    record = Session(job).book.find("fit", 1001)
    assert record is not None
    assert record.facts["unused"]["c00"] == "its matte is empty"
    assert record.facts["unused"]["c01"] == "100 % of its pixels inside the matte are NaN or infinite"
    assert record.facts["clamped"] == {UNUSED: 2}
    assert UNUSED == "fit: cameras left out of a frame, since their matte is empty, or their picture black or damaged"


def test_a_frame_that_is_skipped_is_left_out(tmp_path: Path) -> None:
    session = Session(write_capture_shot(tmp_path, 2, **CHANGES))
    session.dead_marks.set(FIT, [1002], "skipped by the user")
    run_shared(session, RunOptions(until="mesh"))
    result = run_shared(session, RunOptions(until="view"))
    assert result.missing == {(FIT, 1002): "skipped by the user"}
    assert session.look_again(Missing(result.missing))
    assert session.job.frames == (1001,)
    assert session.job.left_out == ((1002, "fit"),)


def test_a_note_that_leaves_no_frame_or_cannot_be_read_counts_for_nothing(tmp_path: Path) -> None:
    note = LeftOut({1: "fit", 2: "view"}, {1: "why", 2: "how"})
    note.write(tmp_path)
    assert LeftOut.read(tmp_path) == note
    assert note.of([1, 2, 3]) == {1: "fit", 2: "view"}
    assert note.of([1, 2]) == {}
    (tmp_path / "left_out.json").write_text(json.dumps([{"frame": 1}]))
    assert LeftOut.read(tmp_path) == LeftOut()
    LeftOut().write(tmp_path)
    assert not list(tmp_path.iterdir())


def test_precomputed_flow_to_a_frame_that_is_left_out_is_not_taken_as_flow_to_the_next(job: Path) -> None:
    one = Session(job).job.model_copy(update={"frames": (1001, 1003), "left_out": ((1002, "fit"),)})
    assert frames_before_gaps(one) == frozenset()
    flow = one.shot.flow.model_copy(update={"path": "flow.####.exr"})
    given = one.model_copy(update={"shot": one.shot.model_copy(update={"flow": flow})})
    assert frames_before_gaps(given) == {1001}


@pytest.mark.parametrize(
    ("radiance", "matte", "fault"),
    [
        (1.0, 1.0, ""),
        (1e-4, 0.6, ""),
        (1.0, 0.4, "its matte is empty"),
        (0.0, 1.0, "its picture is black inside the matte"),
        (np.nan, 1.0, "100 % of its pixels inside the matte are NaN or infinite"),
    ],
)
def test_what_makes_a_picture_useless(radiance: float, matte: float, fault: str) -> None:
    camera: Any = None
    full = np.ones((SIDE, SIDE), np.float32)
    assert fault_of(View("a", camera, None, radiance * np.ones((SIDE, SIDE, 3), np.float32), matte * full)) == fault


def test_two_thirds_of_the_cameras_are_enough() -> None:
    assert [enough(count, 24) for count in (15, 16)] == [False, True]
    assert [enough(count, 3) for count in (1, 2)] == [False, True]
    assert [enough(count, 2) for count in (1, 2)] == [False, True]
    assert enough(1, 1)
