"""Nodes that decompose: windows of a video backend, and the frames of all backends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from yesnt.core.stage_id import StageId
from yesnt.decompose.settings import REUSE_ONLY
from yesnt.decompose.window import Window
from yesnt.io.jobfile import pass_files
from yesnt.io.records import SharedSettings
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_keys, frame_node, node_fields, node_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import DECOMPOSE, FLOW
from yesnt.planning.task_records import BlendWindowsTask, DecomposeTask, ReadPassesTask, TaskRecord, WindowTask


def window_nodes(plan: ShotPlan) -> Iterator[Node]:
    """Every window of a video backend: its members, their mean and spread for each of its frames."""
    if plan.windows:
        settings = _sampling(plan)
        yield from (_window_node(plan, window, settings) for window in plan.windows)


def _window_node(plan: ShotPlan, window: Window, settings: SharedSettings) -> Node:
    stage = StageId("window", lane=window.lane)
    frames = tuple(plan.job.frames[p] for p in window.span)
    inputs = {role: d for frame in frames for role, d in plan.plate_inputs(frame, suffix=f" {frame}").items()}
    fields = node_fields(plan, stage, settings, inputs=inputs, frames=list(frames))
    assert plan.backend is not None
    return Node(stage, window.index, frames, fields, task=WindowTask(plan.backend.weights), transient=True)


def full_frame_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Frames whose materials are read, sampled in full, or blended from windows."""
    settings = _passes(plan) if plan.backend is None else _sampling(plan)
    for frame in plan.present:
        if frame not in plan.keyframes:
            covering = [window for window in plan.windows if plan.job.position(frame) in window.span]
            if covering:
                yield _blended_node(plan, graph, frame, covering, settings)
            else:
                task: TaskRecord = ReadPassesTask() if plan.backend is None else DecomposeTask(plan.backend.weights)
                fields = node_fields(plan, DECOMPOSE, settings, inputs=_inputs(plan, frame))
                yield frame_node(plan, DECOMPOSE, frame, fields, task)


def in_between_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Frames between keyframes: the keyframe's estimate along the flow, and samples where that fails."""
    if plan.backend is None or not plan.keyframes:
        return
    ensemble = changed_fields(of.ensemble_settings(plan.job.shot))
    reuse = {name: value for name, value in ensemble.items() if name in REUSE_ONLY}
    settings = SharedSettings(_sampling(plan), reuse=reuse)
    for frame, keyframe in plan.keyframes.items():
        needs = [graph.committer(DECOMPOSE, keyframe), *_links(plan, graph, frame, keyframe)]
        fields = node_fields(plan, DECOMPOSE, settings, node_keys(needs), inputs=_inputs(plan, frame))
        yield frame_node(plan, DECOMPOSE, frame, fields, DecomposeTask(plan.backend.weights, keyframe), needs)


def _links(plan: ShotPlan, graph: Graph, frame: int, keyframe: int) -> Iterable[Node]:
    """Nodes of the flow from a frame to its keyframe."""
    way = plan.job.frames[plan.job.position(frame) : plan.job.position(keyframe)]
    return (graph.committer(FLOW, one) for one in way)


def _blended_node(plan: ShotPlan, graph: Graph, frame: int, covering: list[Window], settings: SharedSettings) -> Node:
    assert plan.backend is not None
    position, footprint = plan.job.position(frame), plan.backend.footprint
    weights = {StageId("window", lane=w.lane): w.weights[position - w.span.start] for w in covering}
    fields = node_fields(
        plan, DECOMPOSE, settings, frame_keys(graph, frame, weights), inputs=_inputs(plan, frame),
        weights={stage.label: weight for stage, weight in weights.items()},
    )  # fmt: skip
    task = BlendWindowsTask(weights, footprint.nfe / footprint.window)
    return frame_node(plan, DECOMPOSE, frame, fields, task, [graph.committer(stage, frame) for stage in weights])


def _inputs(plan: ShotPlan, frame: int) -> dict[str, str]:
    shot = plan.job.shot
    passes = {} if shot.decompose.samples_backend else pass_files(shot.decompose)
    return plan.plate_inputs(frame) | plan.inputs(frame, **passes)


def _passes(plan: ShotPlan) -> SharedSettings:
    quantities = plan.job.shot.decompose.quantities
    given = {name: changed_keys(one, {"path"}) for name, one in quantities.items()}
    return shared(passes="made before", quantities=given, **plan.plate_settings)


def _sampling(plan: ShotPlan) -> SharedSettings:
    """What a frame sampled in full depends on besides its images."""
    assert plan.backend is not None
    ensemble = changed_fields(of.ensemble_settings(plan.job.shot))
    return shared(
        backend=changed_fields(plan.backend),
        ensemble={name: value for name, value in ensemble.items() if name not in REUSE_ONLY},
        seed=plan.job.shot.seed or None,
        **plan.plate_settings,
    )
