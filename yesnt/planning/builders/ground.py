"""Node of the ground: one for the shot, so that it is the same in every frame; none for a job without a set."""

from __future__ import annotations

from collections.abc import Iterator

from yesnt.planning.builders.assemble import ids, node_fields
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import GROUND, MESH
from yesnt.planning.task_records import GroundTask


def ground_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Where the subject stands, from the proxies of all frames."""
    shot, frames = plan.job.shot, plan.job.frames
    if shot.built_in_set is None:
        return
    assert shot.proxy is not None, "a set needs a proxy"
    settings = shared(
        ground=changed_keys(shot.built_in_set, {"mesh", "color", "roughness", "metallic", "mode"}),
        proxy=changed_keys(shot.proxy, {"path"}),
    )
    inputs = {f"proxy {f}": digest for f in frames for digest in plan.inputs(f, proxy=shot.proxy.path).values()}
    fields = node_fields(plan, GROUND, settings, inputs=inputs)
    made = [node for node in graph if node.stage == MESH]  # proxies that come from Gaussian fields
    yield Node(GROUND, 0, frames[:1], fields, ids(made), GroundTask(frames))
