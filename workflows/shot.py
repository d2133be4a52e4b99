"""The product in one sentence, as a graph.

Keyframes, or windows of frames, are decomposed, flow links each frame to the next, frames between take the keyframe's
materials along the flow and draw what is missing; the shot is weighed and solved along the flow, in chunks if it is
long, and each frame is relit and composited as soon as it is solved.
"""

from __future__ import annotations

from collections.abc import Iterator

from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import ShotPlan


def shot_graph(plan: ShotPlan) -> Graph:
    """All nodes of a shot, needs first."""
    return Graph(_nodes(plan))


def _nodes(plan: ShotPlan) -> Iterator[Node]:
    keys: dict[tuple[str, int], str] = {}

    def add(node: Node) -> Node:
        for frame in node.frames:
            keys[node.stage, frame] = node.frame_key(frame)
        return node

    between = plan.keyframes
    yield from map(add, map(plan.window, plan.windows))
    yield from (add(plan.decompose(frame, keys)) for frame in plan.present if frame not in between)
    yield from map(add, map(plan.flow, plan.linked))
    yield from (add(plan.decompose(frame, keys)) for frame in plan.present if frame in between)
    yield from (add(plan.trust(block, keys)) for block in plan.trusted)
    for sweep in range(1 + plan.exchange.sweeps):
        if plan.exchange.is_joint(sweep):
            yield add(plan.joint(sweep, keys))
        yield from (add(plan.solve(sweep, chunk, band, keys)) for chunk, band in plan.exchange.solved(sweep))
    if not (plan.chunks.whole or plan.exchange.ends_jointly):
        yield from (add(plan.join(block, keys)) for block in plan.exchange.blocks)
    yield from (add(plan.relight(frame, keys)) for frame in plan.delivered)
    yield from (add(plan.composite(frame, keys)) for frame in plan.delivered)
    yield from (add(plan.segment(index, keys)) for index in range(len(plan.segments)))
    if plan.delivered:
        yield add(plan.preview(keys))
