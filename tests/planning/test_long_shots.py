"""Planning a long shot takes time and memory in proportion to its frames, however it is cut."""

from __future__ import annotations

import gc
import time
import tracemalloc
from pathlib import Path

import pytest

from tests.planning.long_shot import long_plan
from tests.tiny_shot import write_tiny_shot
from yesnt.inspect.forecast import forecast
from yesnt.inspect.frame_states import states
from yesnt.planning.graph import Graph
from yesnt.planning.stages import DECOMPOSE
from yesnt.runtime.left_out import Missing
from yesnt.runtime.session import Session
from yesnt.workflows.shot import shot_graph

SMALL, HD = (64, 48), (1920, 1080)


def processor_seconds(frames: int, **cut) -> float:
    """Of one graph, without garbage collection: that takes time by all objects which the tests before have left."""
    plan = long_plan(frames, **cut)
    gc.disable()
    try:
        start = time.process_time()
        assert len(shot_graph(plan)) > 4 * frames
        return time.process_time() - start
    finally:
        gc.enable()


@pytest.mark.parametrize(
    "cut", [{"size": SMALL}, {"size": HD}, {"size": SMALL, "step": 2}], ids=["whole", "bands", "sparse"]
)
def test_the_graph_of_a_long_shot_takes_linear_time(cut: dict) -> None:
    """In the best of four pairs, since other work on the machine slows one measurement or the other."""
    pairs = [(processor_seconds(1600, **cut), processor_seconds(3000, **cut)) for _ in range(4)]
    short, long = min(pairs, key=lambda pair: pair[1] / pair[0])
    assert short < 5, f"1,600 frames took {short:.1f} s of processor time"
    assert long < 10, f"3,000 frames took {long:.1f} s of processor time"
    assert long < 2.5 * short, f"3,000 frames took {long / short:.1f} times as long as 1,600"


def test_a_node_of_a_long_shot_takes_a_few_kilobytes() -> None:
    tracemalloc.start()
    graph = shot_graph(long_plan(800))
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert size < 6_000 * len(graph), f"{size / len(graph):.0f} bytes per node"


def test_bands_and_joint_sweeps_are_planned() -> None:
    """The cases above are what they say: one cut into chunks of whole frames, one also into bands."""
    whole, banded = long_plan(3000), long_plan(3000, size=HD)
    assert whole.chunks.whole
    assert len(whole.exchange.blocks) > 1
    assert whole.exchange.ends_jointly
    assert len(banded.chunks.bands) > 1


def test_a_plan_is_made_once_however_often_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    monkeypatch.setattr("yesnt.runtime.session.shot_graph", lambda plan: built.append(plan) or shot_graph(plan))
    session = Session(write_tiny_shot(tmp_path / "shot", 2))
    forecast(session)
    states(session)
    assert session.graph() is session.graph()
    assert len(built) == 1
    without = Missing({(DECOMPOSE, 1002): "its worker died"})
    assert len(session.graph(without)) < len(session.graph())
    assert built[1].absent == {1002}


def test_a_graph_finds_the_node_that_commits_a_frame() -> None:
    plan = long_plan(40, chunk=8)
    graph = shot_graph(plan)
    for stage in graph.stages:
        for node in graph:
            if node.stage == stage:
                assert all(graph.committer(stage, frame) is node for frame in node.frames)
    with pytest.raises(KeyError):
        graph.committer(graph.stages[0], 999)
    assert isinstance(graph.closure([]), Graph)
