"""The product in one sentence: every frame is decomposed, flow links it to the next, chunks are solved along the flow,
and each frame is relit and composited as soon as its chunk is solved."""  # noqa: D205, D209

from __future__ import annotations

from collections.abc import Iterator

from yesnt.graph import Graph, Node
from yesnt.stages import ShotPlan


def shot_graph(plan: ShotPlan) -> Graph:
    """All nodes of a shot, needs first."""
    return Graph(_nodes(plan))


def _nodes(plan: ShotPlan) -> Iterator[Node]:
    keys: dict[tuple[str, int], str] = {}

    def add(node: Node) -> Node:
        for frame in node.frames:
            keys[node.stage, frame] = node.frame_key(frame)
        return node

    for frame in plan.present:
        yield add(plan.decompose(frame))
    for frame in plan.linked:
        yield add(plan.flow(frame))
    for sweep, blocks in plan.sweeps():
        for block in blocks:
            yield add(plan.solve(sweep, block, keys))
    for frame in plan.delivered:
        yield add(plan.relight(frame, keys))
    for frame in plan.delivered:
        yield add(plan.composite(frame, keys))
    if plan.delivered:
        yield add(plan.preview(keys))
