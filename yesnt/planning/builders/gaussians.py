"""Nodes that fit Gaussian fields and make plates, G-buffers and proxies of them; none for a job without fields."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import replace
from typing import Any

from yesnt.capture.files import camera_files
from yesnt.core.capture_input import CaptureCameras
from yesnt.core.gaussian_input import held_out_of
from yesnt.core.shot import Shot
from yesnt.io.cameras import calibration_roles, cameras_of
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_keys, frame_node, node_fields, node_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, picture_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import FIT, MATTE, MESH, VIEW
from yesnt.planning.task_records import FitTask, MeshTask, ViewTask

_READ_MADE = ("plate", "gbuffer", "proxy")  # roles of inputs that may be made here


def gaussian_nodes(plan: ShotPlan) -> Iterator[Node]:
    """The field, the proxy mesh and the view of every frame, as far as the job takes them from here."""
    shot, graph = plan.job.shot, Graph()
    if shot.gaussians is None:
        return
    if shot.gaussians.path is None:
        graph.extend(_fit_nodes(plan))
        yield from graph
    for frame in (one for one in plan.job.frames if one not in plan.unfitted):
        if shot.proxy is not None and shot.proxy.path in shot.made:
            yield _mesh_node(plan, graph, frame)
        if {shot.plate.path, shot.gbuffer.path} & set(shot.made):
            yield _view_node(plan, graph, frame)


def starts_of(frames: Sequence[int], every: int, lost: Set[int] = frozenset()) -> dict[int, int | None]:
    """Frame -> the nearest keyframe, the earlier of two; None of a keyframe itself. Frames in `lost` are not in it.

    Every `every`-th frame is a keyframe. If it is lost, the next frame that is not takes its place, before the turn of
    the next keyframe.
    """
    good = [position for position, frame in enumerate(frames) if frame not in lost]
    first = dict.fromkeys(position // every for position in good)
    keys = [good[bisect_left(good, number * every)] for number in first]
    nearest = {position: _nearest(keys, position) for position in good}
    return {frames[at]: None if key == at else frames[key] for at, key in nearest.items()}


def _nearest(keys: Sequence[int], position: int) -> int:
    after = bisect_left(keys, position)
    return min(keys[max(after - 1, 0) : after + 1], key=lambda key: (abs(key - position), key))


def _fit_nodes(plan: ShotPlan) -> Iterator[Node]:
    """Keyframes first, then the frames that start from one."""
    shot = plan.job.shot
    assert shot.gaussians is not None
    assert shot.capture is not None
    names = tuple(cameras_of(plan.job.root, shot.capture))
    held_out = held_out_of(names, shot.gaussians.held_out)
    task = FitTask(tuple(name for name in names if name not in held_out), held_out)
    lost = plan.unfitted | set(plan.job.all_but()).difference(plan.job.all_but(MATTE.name, FIT.name))
    starts = starts_of(plan.job.all_but(), shot.gaussians.every, lost)
    keyframes = Graph(_fit_node(plan, Graph(), frame, task) for frame, start in starts.items() if start is None)
    yield from keyframes
    for frame, start in starts.items():
        if start is not None:
            yield _fit_node(plan, keyframes, frame, replace(task, keyframe=start))


def _fit_node(plan: ShotPlan, keyframes: Graph, frame: int, task: FitTask) -> Node:
    job, capture = plan.job, plan.job.shot.capture
    assert capture is not None
    inputs = {role: plan.digests[str(path)] for role, path in calibration_roles(job.root, capture).items()}
    for name in (*task.cameras, *task.held_out):
        files = camera_files(job.root, capture, name, frame)
        inputs |= {f"{role} {name}": plan.digests[str(path)] for role, path in files.items()}
    needs = [] if task.keyframe is None else [keyframes.committer(FIT, task.keyframe)]
    fields = node_fields(plan, FIT, _fit_settings(plan), node_keys(needs), inputs=inputs, held_out=list(task.held_out))
    return frame_node(plan, FIT, frame, fields, task, needs)


def _fit_settings(plan: ShotPlan) -> Any:
    shot = plan.job.shot
    assert shot.capture is not None
    return shared(
        fit=changed_fields(of.fit_settings(shot)),
        pictures=picture_keys(shot.capture),
        color=plan.job.colors.digests("capture"),
        working=changed_keys(shot.color, {"config", "output", "view"}),
    )


def _field_of(plan: ShotPlan, graph: Graph, frame: int) -> tuple[dict[str, str], dict[str, str], list[Node]]:
    """Digests of input files, keys of upstream nodes, and needs of what reads a frame's field."""
    shot = plan.job.shot
    assert shot.gaussians is not None
    if shot.gaussians.path is not None:
        return plan.inputs(frame, field=shot.gaussians.path), {}, []
    return {}, frame_keys(graph, frame, [FIT]), [graph.committer(FIT, frame)]


def _mesh_node(plan: ShotPlan, graph: Graph, frame: int) -> Node:
    shot = plan.job.shot
    inputs, upstream, needs = _field_of(plan, graph, frame)
    if shot.capture is not None:
        files = calibration_roles(plan.job.root, shot.capture)
        inputs |= {role: plan.digests[str(path)] for role, path in files.items()}
    settings = shared(mesh=changed_fields(of.mesh_settings(shot)), world=_world(shot.capture), held_out=_held_out(shot))
    fields = node_fields(plan, MESH, settings, upstream, inputs=inputs)
    return frame_node(plan, MESH, frame, fields, MeshTask(), needs)


def _world(capture: CaptureCameras | None) -> dict[str, Any]:
    """What the job says of the calibration's world, where that is not the usual."""
    return {} if capture is None else {k: v for k, v in changed_keys(capture).items() if k in ("units", "up")}


def _held_out(shot: Shot) -> list[str] | None:
    """Cameras that the field was not fitted to, whatever they see."""
    return None if shot.gaussians is None or shot.gaussians.held_out is None else [str(shot.gaussians.held_out)]


def _view_node(plan: ShotPlan, graph: Graph, frame: int) -> Node:
    inputs, upstream, needs = _field_of(plan, graph, frame)
    inputs |= plan.inputs(frame, camera=plan.job.shot.camera)
    fields = node_fields(plan, VIEW, shared(), upstream, inputs=inputs)
    return frame_node(plan, VIEW, frame, fields, ViewTask(), needs)


def after_views(graph: Graph, nodes: Iterable[Node]) -> Iterator[Node]:
    """Nodes that read what is made from fields, with the nodes that make it among their needs."""
    makers = [stage for stage in (MESH, VIEW) if stage in graph.stages]
    for node in nodes:
        reads = makers and any(role.split()[0].removeprefix("next_") in _READ_MADE for role in node.inputs)
        if not reads:
            yield node
            continue
        made = tuple(graph.committer(stage, frame).id for stage in makers for frame in node.frames)
        yield replace(node, needs=tuple(dict.fromkeys((*node.needs, *made))))
