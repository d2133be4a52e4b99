"""Nodes that make plates, G-buffers and proxies from Gaussian fields; none for a job that brings its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from yesnt.core.capture_input import CaptureCameras
from yesnt.io.cameras import calibration_roles
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_node, node_fields
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import MESH, VIEW
from yesnt.planning.task_records import MeshTask, ViewTask

_READ_MADE = ("plate", "gbuffer", "proxy")  # roles of inputs that may be made here


def gaussian_nodes(plan: ShotPlan) -> Iterator[Node]:
    """The proxy mesh and the view of every frame, as far as the job takes them from its fields."""
    shot = plan.job.shot
    for frame in plan.job.frames if shot.gaussians else ():
        if shot.proxy is not None and shot.proxy.path in shot.made:
            yield _mesh_node(plan, frame)
        if {shot.plate.path, shot.gbuffer.path} & set(shot.made):
            yield _view_node(plan, frame)


def _mesh_node(plan: ShotPlan, frame: int) -> Node:
    shot = plan.job.shot
    assert shot.gaussians is not None
    inputs = plan.inputs(frame, field=shot.gaussians.path)
    if shot.capture is not None:
        files = calibration_roles(plan.job.root, shot.capture)
        inputs |= {role: plan.digests[str(path)] for role, path in files.items()}
    settings = shared(mesh=changed_fields(of.mesh_settings(shot)), world=_world(shot.capture))
    return frame_node(plan, MESH, frame, node_fields(plan, MESH, settings, inputs=inputs), MeshTask())


def _view_node(plan: ShotPlan, frame: int) -> Node:
    shot = plan.job.shot
    assert shot.gaussians is not None
    inputs = plan.inputs(frame, field=shot.gaussians.path, camera=shot.camera)
    return frame_node(plan, VIEW, frame, node_fields(plan, VIEW, shared(), inputs=inputs), ViewTask())


def _world(capture: CaptureCameras | None) -> dict[str, Any]:
    """What the job says of the calibration's world, where that is not the usual."""
    return {} if capture is None else {k: v for k, v in changed_keys(capture).items() if k in ("units", "up")}


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
