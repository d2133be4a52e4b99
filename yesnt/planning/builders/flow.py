"""Nodes of the optical flow: one for each frame that has a next one."""

from __future__ import annotations

from collections.abc import Iterator

from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_node, node_fields
from yesnt.planning.graph import Node
from yesnt.planning.keyed_settings import changed_fields, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import FLOW
from yesnt.planning.task_records import FlowTask


def flow_nodes(plan: ShotPlan) -> Iterator[Node]:
    """Flow of every frame to the next, and its validity."""
    shot, frames = plan.job.shot, plan.job.frames
    settings = shared(flow=changed_fields(of.flow_settings(shot)), **plan.plate_settings)
    for frame in plan.linked:
        inputs = plan.plate_inputs(frame) | plan.inputs(frame, flow=shot.flow.path, weights=shot.flow.weights)
        inputs |= plan.plate_inputs(frames[plan.job.position(frame) + 1], "next_")
        fields = node_fields(plan, FLOW, settings, inputs=inputs)
        yield frame_node(plan, FLOW, frame, fields, FlowTask())
