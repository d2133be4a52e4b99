"""The frame grid follows the driver's events."""

from __future__ import annotations

import numpy as np

from yesnt.core.stage_id import StageId
from yesnt.planning.frame_grid import DEAD, DONE, FAILED, NONE, RUNNING, WAITING, FrameGrid
from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import COMPOSITE, RELIGHT, SOLVE

FRAMES = (1001, 1002, 1003, 1005)


def node(stage: StageId, index: int, *frames: int) -> Node:
    return Node(stage, index, frames, {"stage": stage.label, "frames": frames})


def grid() -> FrameGrid:
    """A joint solve of all frames in two sweeps, relighting frame by frame; frame 1005 is not composited."""
    made = FrameGrid(FRAMES, megapixels=1.0)
    nodes = [node(StageId("solve", sweep=0), 0, *FRAMES), node(SOLVE, 0, *FRAMES)]
    nodes += [node(RELIGHT, i, frame) for i, frame in enumerate(FRAMES)]
    nodes += [node(COMPOSITE, i, frame) for i, frame in enumerate(FRAMES[:3])]
    made.lay_out(Graph(nodes), [(RELIGHT, 0)])
    return made


def event(kind: str, stage: StageId, *frames: int, **facts) -> dict[str, object]:
    return {"event": kind, "stage": stage.label, "frames": list(frames), "seconds": 2.0, "reason": "why", **facts}


def test_states_before_anything_ran() -> None:
    shown = grid()
    assert shown.states("solve").tolist() == [WAITING] * 4
    assert shown.states("relight").tolist() == [DONE, WAITING, WAITING, WAITING]
    assert shown.states("composite").tolist() == [WAITING, WAITING, WAITING, NONE]


def test_a_frame_is_done_when_all_tasks_of_its_stage_are() -> None:
    shown = grid()
    shown.apply(event("start", StageId("solve", sweep=0), *FRAMES))
    assert shown.states("solve").tolist() == [RUNNING] * 4
    shown.apply(event("done", StageId("solve", sweep=0), *FRAMES))
    assert shown.states("solve").tolist() == [WAITING] * 4
    shown.apply(event("start", SOLVE, *FRAMES))
    shown.apply(event("done", SOLVE, *FRAMES))
    assert shown.states("solve").tolist() == [DONE] * 4


def test_a_task_that_records_and_events_both_report_counts_once() -> None:
    shown = grid()
    for _ in range(2):
        shown.apply(event("done", RELIGHT, 1001))
        shown.apply(event("done", RELIGHT, 1002))
    relight = next(stage for stage in shown.summary()["stages"] if stage["name"] == "relight")
    assert (relight["finished"], shown.running_tasks) == (2, 0)
    assert not shown.finished


def test_lost_frames_keep_their_reason_in_the_next_pass() -> None:
    shown = grid()
    for kind in ("start", "failed"):
        shown.apply(event(kind, RELIGHT, 1002, reason="no depth"))
    for kind in ("start", "dead"):
        shown.apply(event(kind, RELIGHT, 1005, reason="died twice"))
    assert shown.states("relight").tolist() == [DONE, FAILED, WAITING, DEAD]
    shown.lay_out(Graph([node(RELIGHT, 0, 1001), node(RELIGHT, 2, 1003)]), [(RELIGHT, 0)])
    assert shown.states("relight").tolist() == [DONE, FAILED, WAITING, DEAD]
    assert shown.summary()["lost"] == [
        {"stage": "relight", "frame": 1002, "reason": "no depth"},
        {"stage": "relight", "frame": 1005, "reason": "died twice"},
    ]


def test_a_task_that_is_tried_again_waits() -> None:
    shown = grid()
    for kind in ("start", "retry"):
        shown.apply(event(kind, RELIGHT, 1002))
    assert shown.states("relight")[1] == WAITING
    assert shown.running_tasks == 0


def test_time_left_counts_what_records_and_events_say_once() -> None:
    shown = grid()
    shown.apply(event("start", RELIGHT, 1001))
    shown.apply(event("done", RELIGHT, 1001, seconds=100.0))  # a record had told of it before
    assert shown.time.mean("relight") is None
    shown.apply(event("done", RELIGHT, 1002, seconds=4.0))
    shown.apply(event("done", COMPOSITE, 1002, seconds=1.0))
    assert (shown.time.mean("relight"), shown.newest) == (4.0, 1002)
    assert shown.summary()["seconds_left"] > 0


def test_summary_joins_neighbours_of_equal_state() -> None:
    shown = grid()
    shown.apply(event("start", RELIGHT, 1003))
    relight = next(stage for stage in shown.summary()["stages"] if stage["name"] == "relight")
    assert relight["runs"] == [[DONE, 1], [WAITING, 1], [RUNNING, 1], [WAITING, 1]]
    assert (relight["tasks"], relight["finished"], relight["seconds_each"]) == (4, 1, None)
    assert shown.summary()["frames"] == "1001-1003,1005"


def test_a_long_shot_is_summed_up_in_milliseconds() -> None:
    import time

    frames = tuple(range(1, 10_001))
    shown = FrameGrid(frames, 1.0)
    shown.lay_out(Graph(node(RELIGHT, i, frame) for i, frame in enumerate(frames)), [])
    for frame in frames[::2]:
        shown.apply(event("done", RELIGHT, frame))
    took = []
    for _ in range(3):
        began = time.thread_time()
        summary = shown.summary()
        took.append(time.thread_time() - began)
    assert min(took) < 0.2
    assert np.sum([length for _, length in summary["stages"][0]["runs"]]) == len(frames)
