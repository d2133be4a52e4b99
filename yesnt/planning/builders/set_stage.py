"""Nodes of the set: one for each delivered frame; none for a job without a set."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from yesnt.core.shot import Shot
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_keys, frame_node, node_fields, node_keys
from yesnt.planning.builders.sides import sides_of
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import GROUND, RELIGHT, SET, SOLVE
from yesnt.planning.task_records import SetTask


def set_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """The light on the set in every frame."""
    shot = plan.job.shot
    if shot.built_in_set is None:
        return
    ground = graph.committer(GROUND, plan.job.frames[0])
    for frame in plan.delivered:
        inputs = plan.plate_inputs(frame) | plan.inputs(
            frame, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path if shot.proxy else None, light=shot.light.path,
            camera=shot.camera, mesh=shot.built_in_set.mesh,
        )  # fmt: skip
        upstream = frame_keys(graph, frame, (SOLVE, RELIGHT)) | node_keys([ground])
        sides = sides_of(plan, frame)
        settings = _settings(plan, shot, frame)
        fields = node_fields(plan, SET, settings, upstream, inputs=inputs | sides.inputs, **sides.fields)
        needs = [graph.committer(stage, frame) for stage in (SOLVE, RELIGHT)] + [ground]
        yield frame_node(plan, SET, frame, fields, SetTask(sides.cameras), needs)


def _settings(plan: ShotPlan, shot: Shot, frame: int) -> Any:
    assert shot.set is not None
    assert shot.proxy is not None, "a set needs a proxy"
    return shared(
        relight=changed_fields(of.relight_settings(shot)),
        set=changed_keys(shot.set, {"mesh"}),
        sun=True if shot.light_groups else None,
        light=changed_keys(shot.light.at(frame), {"path"}),
        gbuffer=changed_keys(shot.gbuffer, {"path"}),
        proxy=changed_keys(shot.proxy, {"path"}),
        **plan.plate_settings | {"color": plan.job.colors.digests("plate_working", "light")},
    )
