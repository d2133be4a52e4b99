"""The graph of a shot: which nodes there are, what each needs, and which keys a change reaches."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml

from tests.cases.shots import FRAME, camera, write_json, write_shot
from yesnt.core.blocks import row_bands
from yesnt.core.shot import ExrOutput
from yesnt.core.stage_id import StageId
from yesnt.io.preview import SEGMENT_FRAMES
from yesnt.io.records import key_of
from yesnt.planning.graph import Graph, Node, NodeId
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import COMPOSITE, CONFIDENCE, DECOMPOSE, FLOW, PREVIEW, RELIGHT, SEGMENT, SOLVE
from yesnt.planning.task_records import (
    ConfidenceTask,
    Gaps,
    JoinBandsTask,
    PreviewSegmentTask,
    PreviewTask,
    SolveBlockTask,
    SolveJointlyTask,
    TaskRecord,
    WindowTask,
    held_frames,
)
from yesnt.runtime.session import Session
from yesnt.workflows.shot import shot_graph


def plan_of(path: Path, **gaps: frozenset[int]) -> ShotPlan:
    """The plan of a shot, some of whose frames cannot be had."""
    return dataclasses.replace(Session(path).plan(), **gaps)


def edit(path: Path, **keys: object) -> None:
    """Sets top-level keys of a job file."""
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | keys))


def needs_of(graph: Graph, stage: StageId, index: int = 0) -> set[NodeId]:
    """What a node needs."""
    return set(graph.nodes[stage, index].needs)


def frames_of(graph: Graph, stage: StageId) -> list[tuple[int, ...]]:
    """Frames that each node of a stage commits, in order."""
    return [node.frames for node in graph if node.stage == stage]


def long_shot(folder: Path, frames: int, **job: object) -> Path:
    """A shot of many frames whose sequences are single files."""
    names = {"plate": "plate", "gbuffer": "gbuffer", "decompose": "material"}
    sections = {key: {"path": f"{name}.exr"} for key, name in names.items()}
    write_shot(folder, numbers=f"{FRAME}-{FRAME + frames - 1}", **sections, **job)
    for name in names.values():
        (folder / f"{name}.{FRAME}.exr").rename(folder / f"{name}.exr")
    write_json(folder / "camera.json", camera(tuple(range(FRAME, FRAME + frames))))
    return folder / "shot.yaml"


def test_a_short_shot_has_a_node_a_frame_and_one_solve(tiny_shot: Path) -> None:
    graph = shot_graph(plan_of(tiny_shot))
    frames = [(n,) for n in range(1001, 1005)]
    assert [frames_of(graph, stage) for stage in (DECOMPOSE, RELIGHT, COMPOSITE)] == [frames] * 3
    assert frames_of(graph, FLOW) == frames[:-1]
    assert frames_of(graph, CONFIDENCE) == frames_of(graph, SOLVE) == [(1001, 1002, 1003, 1004)]
    assert [node.index for node in graph if node.stage == RELIGHT] == [0, 1, 2, 3]
    observed = {(DECOMPOSE, i) for i in range(4)} | {(FLOW, i) for i in range(3)}
    assert needs_of(graph, CONFIDENCE) == observed
    assert needs_of(graph, SOLVE) == observed | {(CONFIDENCE, 0)}
    assert needs_of(graph, RELIGHT, 2) == {(SOLVE, 0)}
    assert needs_of(graph, COMPOSITE, 2) == {(RELIGHT, 2), (DECOMPOSE, 2)}
    assert needs_of(graph, SEGMENT) == {(COMPOSITE, i) for i in range(4)}
    assert needs_of(graph, PREVIEW) == {(SEGMENT, 0)}
    assert {node.stage for node in graph if node.transient} == {SEGMENT}


def test_every_key_is_the_hash_of_its_fields(tiny_shot: Path) -> None:
    edit(tiny_shot, temporal={"chunk": 2, "halo": 1, "sweeps": 3})
    graph = shot_graph(plan_of(tiny_shot))
    keys = [node.frame_key(frame) for node in graph for frame in node.frames]
    assert keys == [key_of(node.frame_fields(frame)) for node in graph for frame in node.frames]
    assert len(set(keys)) == len(keys)


@dataclass(frozen=True)
class Change:
    """A change of an input: what is done to it, and the nodes that must notice by themselves, as stage and indices."""

    make: Callable[[Path], object]
    direct: dict[StageId, Iterable[int]] = field(default_factory=dict)


def copied(source: str, target: str) -> Callable[[Path], object]:
    """Replaces a file of the shot by another."""
    return lambda path: shutil.copy(path.parent / source, path.parent / target)


def section(name: str, **keys: object) -> Callable[[Path], object]:
    """Adds keys to a section of the job file."""
    return lambda path: edit(path, **{name: yaml.safe_load(path.read_text()).get(name, {}) | keys})


def turned(path: Path) -> None:
    """Moves the camera."""
    moved = (1, 0, 0, 0.1, 0, 0, 1, -3, 0, -1, 0, 0, 0, 0, 0, 1)
    write_json(path.parent / "camera.json", camera(tuple(range(1001, 1005)), moved, (40, 32)))


ALL = range(4)
CHANGES = {
    "plate": Change(
        copied("plate.1001.exr", "plate.1003.exr"), {DECOMPOSE: [2], FLOW: [1, 2], RELIGHT: [2]}
    ),
    "last plate": Change(copied("plate.1001.exr", "plate.1004.exr"), {DECOMPOSE: [3], FLOW: [2], RELIGHT: [3]}),
    "G-buffer": Change(copied("gbuffer.1001.exr", "gbuffer.1003.exr"), {RELIGHT: [2]}),
    "material pass": Change(copied("material.1001.exr", "material.1003.exr"), {DECOMPOSE: [2]}),
    "proxy": Change(copied("proxy.1001.ply", "proxy.1003.ply"), {RELIGHT: [2]}),
    "camera": Change(turned, {RELIGHT: ALL}),
    "light": Change(copied("plate.1001.exr", "light.exr"), {RELIGHT: ALL, COMPOSITE: ALL}),
    "light's turn": Change(section("light", rotation=[10, 0, 0]), {RELIGHT: ALL}),
    "light's turn, animated": Change(
        section("light", rotation={1002: [0, 0, 0], 1004: [10, 0, 0]}), {RELIGHT: [2, 3]}
    ),
    "light's exposure, a key that changes nothing": Change(section("light", exposure={1002: 0})),
    "relighting": Change(section("relight", texels=9), {RELIGHT: ALL}),
    "flow": Change(section("flow", knobs={"method": "dis"}), {FLOW: range(3)}),
    "energy": Change(section("temporal", knobs={"lambda2": 2.5}), {SOLVE: [0]}),
    "tolerance": Change(section("temporal", tolerance=1e-3), {SOLVE: [0]}),
    "robust": Change(section("temporal", robust=False), {CONFIDENCE: [0]}),
    "compression": Change(section("exr", compression="piz"), {COMPOSITE: ALL}),
    "name": Change(lambda path: edit(path, name="other"), {COMPOSITE: ALL, SEGMENT: [0]}),
    "colour space": Change(
        section("plate", colorspace="srgb"), {DECOMPOSE: ALL, FLOW: range(3), RELIGHT: ALL}
    ),
    "output": Change(lambda path: edit(path, output="elsewhere")),
    "default": Change(section("exr", compression="zip")),
}  # fmt: skip


def users_of(graph: Graph, nodes: set[NodeId]) -> set[NodeId]:
    """The nodes and all that need them."""
    users, reached, stack = graph.users(), set[NodeId](), list(nodes)
    while stack:
        node = stack.pop()
        if node not in reached:
            reached.add(node)
            stack.extend(users[node])
    return reached


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_reaches_what_reads_it_and_all_that_follows(tiny_shot: Path, name: str) -> None:
    plan = plan_of(tiny_shot)
    before = shot_graph(plan)
    CHANGES[name].make(tiny_shot)
    changed_plan = plan_of(tiny_shot)
    after = shot_graph(changed_plan)
    changed = {node.id for node in after if node.key != before.nodes[node.id].key}
    direct = {(stage, index) for stage, indices in CHANGES[name].direct.items() for index in indices}
    if changed_plan.job_digest != plan.job_digest:  # stands in the header of every EXR
        direct |= {(COMPOSITE, i) for i in ALL}
    assert changed == users_of(after, direct)


def test_frames_that_cannot_be_had_are_needed_by_nothing(tiny_shot: Path) -> None:
    plan = plan_of(tiny_shot, absent=frozenset({1002}), unlinked=frozenset({1003}), undelivered=frozenset({1004}))
    graph = shot_graph(plan)
    assert frames_of(graph, DECOMPOSE) == [(1001,), (1003,), (1004,)]
    assert frames_of(graph, FLOW) == [(1001,), (1002,)]
    assert frames_of(graph, RELIGHT) == frames_of(graph, COMPOSITE) == [(1001,), (1003,)]
    assert needs_of(graph, CONFIDENCE) == {(DECOMPOSE, 0), (DECOMPOSE, 2), (DECOMPOSE, 3), (FLOW, 0), (FLOW, 1)}
    for stage in (CONFIDENCE, SOLVE):
        task = graph.nodes[stage, 0].task
        assert isinstance(task, ConfidenceTask | SolveBlockTask)
        assert task.gaps == Gaps(frozenset({1002}), frozenset({1003}))
    whole = shot_graph(plan_of(tiny_shot))
    assert graph.nodes[CONFIDENCE, 0].key != whole.nodes[CONFIDENCE, 0].key
    assert graph.nodes[DECOMPOSE, 2].key == whole.nodes[DECOMPOSE, 2].key


def test_nothing_is_previewed_where_nothing_is_delivered(tiny_shot: Path) -> None:
    graph = shot_graph(plan_of(tiny_shot, undelivered=frozenset(range(1001, 1005))))
    assert frames_of(graph, SEGMENT) == frames_of(graph, PREVIEW) == []


def test_the_preview_has_a_segment_for_every_second(tmp_path: Path) -> None:
    graph = shot_graph(plan_of(long_shot(tmp_path / "s", 2 * SEGMENT_FRAMES + 2)))
    segments = [node for node in graph if node.stage == SEGMENT]
    tasks = [node.task for node in segments]
    assert [len(task.frames) for task in tasks if isinstance(task, PreviewSegmentTask)] == [24, 24, 2]
    assert [(node.index, node.frames) for node in segments] == [(0, (1001,)), (1, (1025,)), (2, (1049,))]
    assert needs_of(graph, SEGMENT, 1) == {(COMPOSITE, i) for i in range(24, 48)}
    assert graph.nodes[PREVIEW, 0].task == PreviewTask(3)
    assert needs_of(graph, PREVIEW) == {(SEGMENT, i) for i in range(3)}


def test_blocks_need_what_they_load(tmp_path: Path) -> None:
    temporal = {"chunk": 4, "halo": 2, "sweeps": 3}
    plan = plan_of(long_shot(tmp_path / "s", 12, temporal=temporal))
    graph = shot_graph(plan)
    assert frames_of(graph, CONFIDENCE) == [tuple(range(1001 + i, 1005 + i)) for i in (0, 4, 8)]
    first = StageId("solve", 0)
    assert needs_of(graph, first, 1) == (
        {(DECOMPOSE, i) for i in range(2, 10)} | {(FLOW, i) for i in range(2, 9)} | {(CONFIDENCE, i) for i in (0, 1, 2)}
    )
    assert needs_of(graph, first, 0) == (
        {(DECOMPOSE, i) for i in range(6)} | {(FLOW, i) for i in range(5)} | {(CONFIDENCE, i) for i in (0, 1)}
    )
    again = next(node for node in graph if node.stage == StageId("solve", 1) and node.index == 1)
    assert {need for need in again.needs if need[0].name == "solve"} == {(first, 0), (first, 1), (first, 2)}
    assert {need[1] for need in again.needs if need[0] == DECOMPOSE} == set(range(1, 11))
    last = [node for node in graph if node.stage == SOLVE]
    assert [node.frames for node in last] == [tuple(plan.job.frames)]
    assert isinstance(last[0].task, SolveJointlyTask)
    assert {node.stage.sweep for node in graph if node.transient and node.stage.name == "solve"} == {0, 1, 2}


def test_a_graph_refuses_what_comes_too_early_or_twice() -> None:
    one = Node(DECOMPOSE, 0, (1001,), {"a": 1})
    two = Node(RELIGHT, 0, (1001,), {"b": 1}, (one.id,))
    with pytest.raises(ValueError, match="before what it needs"):
        Graph([two, one])
    with pytest.raises(ValueError, match="comes twice"):
        Graph([one, one])
    graph = Graph([one, two])
    assert graph.users() == {one.id: [two.id], two.id: []}
    assert graph.stages == (DECOMPOSE, RELIGHT)
    assert graph.committer(RELIGHT, 1001) is two
    assert list(graph.closure([one.id])) == [one]
    assert list(graph.closure([two.id])) == [one, two]
    assert two.without_needs().needs == ()
    assert two.without_needs().key == two.key


def test_only_settings_that_differ_enter_a_key() -> None:
    @dataclass(frozen=True)
    class Inner:
        a: int = 1
        b: int = 2

    @dataclass(frozen=True)
    class Outer:
        name: str
        inner: Inner = Inner()
        listed: tuple[int, ...] = field(default_factory=tuple)

    assert changed_fields(Outer("x")) == {"name": "x"}
    assert changed_fields(Outer("x", Inner(b=3), (1,))) == {"name": "x", "inner": {"b": 3}, "listed": (1,)}
    assert changed_keys(ExrOutput()) == {}
    assert changed_keys(ExrOutput(compression="piz")) == {"compression": "piz"}
    assert changed_keys(ExrOutput(compression="piz"), {"compression"}) == {}
    assert dict(shared(a=0, b=None, c={}, d=(), e=[], f={"x": 1})) == {"a": 0, "f": {"x": 1}}


def test_gaps_are_those_among_the_frames() -> None:
    gaps = Gaps(frozenset({1, 5}), frozenset({2}))
    assert gaps.among([1, 2, 3]) == Gaps(frozenset({1}), frozenset({2}))
    assert Gaps().among([1]) == Gaps()
    assert Gaps(unlinked=frozenset({4})).among([1, 4]) == Gaps(frozenset(), frozenset({4}))


def test_tasks_say_how_many_frames_they_hold(tmp_path: Path) -> None:
    graph = shot_graph(plan_of(long_shot(tmp_path / "s", 12, temporal={"chunk": 4, "halo": 2, "sweeps": 3})))

    def held(stage: StageId, index: int) -> int:
        node = graph.nodes[stage, index]
        return held_frames(node.task, node.frames)

    task = graph.nodes[CONFIDENCE, 1].task
    assert isinstance(task, ConfidenceTask)
    assert held(CONFIDENCE, 1) == len(task.loaded) > 4
    assert [held(StageId("solve", 0), i) for i in range(3)] == [6, 8, 6]
    assert held(SOLVE, 0) == 12
    assert held(RELIGHT, 3) == 1
    assert held_frames(WindowTask("w"), (1, 2, 3)) == 3
    assert held_frames(TaskRecord(), (1, 2, 3)) == 1


def test_bands_are_joined_to_whole_frames(tiny_shot: Path) -> None:
    plan = plan_of(tiny_shot)
    half = dataclasses.replace(plan.chunks, bands=row_bands(32, 16, 4), sweeps=2, joint=0, reach=4)
    graph = shot_graph(dataclasses.replace(plan, chunks=half))
    joined = graph.nodes[SOLVE, 0]
    assert isinstance(joined.task, JoinBandsTask)
    assert joined.frames == (1001, 1002, 1003, 1004)
    assert {need[0].band for need in joined.needs} == {0, 1}
    assert all(node.stage.band is not None for node in graph if isinstance(node.task, SolveBlockTask))
    arrays = dataclasses.replace(plan, chunks=half).arrays()
    assert arrays["solve.sweep0.band1.material"] == ("material", 16)
