"""Frames between keyframes in the pipeline: who needs whom, and the same bytes in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.in_process import run_here, shard_digests
from tests.tiny_shot import write_tiny_shot
from yesnt.inspect.sampling_cost import sampling_cost
from yesnt.io.store import FrameStore
from yesnt.planning.stages import DECOMPOSE, FLOW
from yesnt.runtime.left_out import Missing
from yesnt.runtime.session import Session

KEYFRAMED = {"backend": "embedded", "samples": 2, "knobs": {"keyframe_step": 3, "steps": 1}}


def test_frames_between_need_their_keyframe_and_the_flow_to_it(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 6, decompose=KEYFRAMED))
    assert session.plan().keyframes == {1002: 1004, 1003: 1004, 1005: 1006}
    graph = session.graph()
    assert set(graph.nodes[DECOMPOSE, 1].needs) == {(DECOMPOSE, 3), (FLOW, 1), (FLOW, 2)}
    assert graph.nodes[DECOMPOSE, 3].needs == ()


def test_a_frame_that_cannot_reach_its_keyframe_is_sampled_in_full(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 7, decompose=KEYFRAMED))
    assert session.plan(Missing({(FLOW, 1003): "lost"})).keyframes == {1005: 1007, 1006: 1007}
    assert session.plan(Missing({(DECOMPOSE, 1004): "lost"})).keyframes == {1005: 1007, 1006: 1007}


def test_passes_have_no_keyframes(tmp_path: Path) -> None:
    assert Session(write_tiny_shot(tmp_path / "shot", 4)).plan().keyframes == {}


def test_thresholds_of_reuse_leave_keyframes_as_they_are(tmp_path: Path) -> None:
    knobs = {**KEYFRAMED["knobs"], "reuse_share": 0.5}
    one = Session(write_tiny_shot(tmp_path / "a", 4, decompose=KEYFRAMED)).graph()
    two = Session(write_tiny_shot(tmp_path / "b", 4, decompose={**KEYFRAMED, "knobs": knobs})).graph()
    assert one.nodes[DECOMPOSE, 0].key == two.nodes[DECOMPOSE, 0].key
    assert one.nodes[DECOMPOSE, 1].key != two.nodes[DECOMPOSE, 1].key


def test_a_subset_first_gives_the_bytes_of_a_whole_run_and_few_evaluations(tmp_path: Path) -> None:
    names = ("observed", "spread", "nfe")
    whole = run_here(write_tiny_shot(tmp_path / "whole", 4, decompose=KEYFRAMED))
    pieces = write_tiny_shot(tmp_path / "pieces", 4, decompose=KEYFRAMED)
    run_here(pieces, frames="1003", order=1)
    session = run_here(pieces, order=2)
    assert shard_digests(session, *names) == shard_digests(whole, *names)
    assert len(shard_digests(session, *names)) == 12
    spent = [session.book.find("decompose", f).facts["nfe"] for f in session.job.frames]
    assert spent[1] <= spent[0] == spent[3]
    assert np.isfinite(FrameStore(session.output.store).read("observed", 1)).all()


def test_the_plan_tells_how_many_evaluations_there_will_be(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 4, decompose={**KEYFRAMED, "samples": 8})
    session = Session(path)
    before = sampling_cost(session, session.graph())
    assert before.fixed == before.most == 4 * 8, "one patch a frame, one step"
    assert before.least == 2 * 8, "two keyframes; without a tolerance they sample all members"
    assert before.least < before.expected <= before.most
    run_here(path, frames="1001")
    after = sampling_cost(session, session.graph())
    assert after.most == before.most - 8
    run_here(path)
    assert sampling_cost(session, session.graph()).most == 0


def test_a_backend_that_predicts_the_mean_stops_at_the_first_members_and_the_plan_says_so(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path, 2, decompose={"samples": 8, "knobs": {"tolerance": 0.02, "steps": 1}})
    session = Session(path)
    before = sampling_cost(session, session.graph())
    assert before.least == before.expected == before.most == 2 * 2
    run_here(path)
    assert sum(session.book.find("decompose", f).facts["nfe"] for f in session.job.frames) == 4
