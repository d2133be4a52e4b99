"""Frames between keyframes in the pipeline: who needs whom, and the same bytes in any order."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from tests.tiny_shot import write_tiny_shot
from yesnt.cluster import ClusterSpec, open_cluster
from yesnt.io.store import FrameStore
from yesnt.session import Missing, RunOptions, Session

DECOMPOSE = {"backend": "embedded", "samples": 2, "knobs": {"keyframe_step": 3, "steps": 1}}


@pytest.fixture(scope="module")
def cluster():
    with open_cluster(ClusterSpec("local", 2)) as client:
        yield ClusterSpec(client.scheduler.address)


def decomposed(path: Path, cluster: ClusterSpec, *frames: str) -> dict[str, str]:
    for chosen in frames:
        assert not Session(path).run(RunOptions(chosen or None, "decompose", cluster)).missing
    store = path.parent / "out" / "store.zarr"
    arrays = ("observed", "spread", "evaluations")
    files = sorted(p for name in arrays for p in (store / name / "c").rglob("*") if p.is_file())
    return {str(p.relative_to(store)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_frames_between_need_their_keyframe_and_the_flow_to_it(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 6, decompose=DECOMPOSE))
    assert session.plan().keyframes == {1002: 1004, 1003: 1004, 1005: 1006}
    graph = session.graph()
    assert set(graph.nodes["decompose", 1].needs) == {("decompose", 3), ("flow", 1), ("flow", 2)}
    assert graph.nodes["decompose", 3].needs == ()


def test_a_frame_that_cannot_reach_its_keyframe_is_drawn_in_full(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 7, decompose=DECOMPOSE))
    assert session.plan(Missing({("flow", 1003): "lost"})).keyframes == {1005: 1007, 1006: 1007}
    assert session.plan(Missing({("decompose", 1004): "lost"})).keyframes == {1005: 1007, 1006: 1007}


def test_passes_have_no_keyframes(tmp_path: Path) -> None:
    assert Session(write_tiny_shot(tmp_path / "shot", 4)).plan().keyframes == {}


def test_thresholds_of_reuse_leave_keyframes_as_they_are(tmp_path: Path) -> None:
    knobs = {**DECOMPOSE["knobs"], "reuse_share": 0.5}
    one = Session(write_tiny_shot(tmp_path / "a", 4, decompose=DECOMPOSE)).graph()
    two = Session(write_tiny_shot(tmp_path / "b", 4, decompose={**DECOMPOSE, "knobs": knobs})).graph()
    assert one.nodes["decompose", 0].key == two.nodes["decompose", 0].key
    assert one.nodes["decompose", 1].key != two.nodes["decompose", 1].key


def test_a_subset_first_gives_the_bytes_of_a_whole_run_and_few_evaluations(
    tmp_path: Path, cluster: ClusterSpec
) -> None:
    whole = decomposed(write_tiny_shot(tmp_path / "whole", 4, decompose=DECOMPOSE), cluster, "")
    pieces = write_tiny_shot(tmp_path / "pieces", 4, decompose=DECOMPOSE)
    assert decomposed(pieces, cluster, "1003", "1001", "") == whole
    assert len(whole) == 12
    session = Session(pieces)
    spent = [session.book.find("decompose", f).facts["evaluations"] for f in session.job.frames]
    assert spent[1] <= spent[0] == spent[3]
    store = FrameStore(session.output.store)
    observed = store.read("observed", 1)
    assert np.isfinite(observed).all()
