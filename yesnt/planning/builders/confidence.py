"""Nodes of the confidence: data weights of chunks of frames."""

from __future__ import annotations

from collections.abc import Iterator

from yesnt.core.blocks import Span
from yesnt.planning.builders.assemble import ids, node_fields, node_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import CONFIDENCE, FLOW
from yesnt.planning.task_records import ConfidenceTask


def confidence_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Confidence of every chunk: 1 - spread, less where a frame contradicts its neighbours."""
    temporal = changed_keys(plan.job.shot.temporal)
    settings = shared(**{name: value for name, value in temporal.items() if name == "robust"})
    frames = plan.job.frames
    for chunk in plan.confidence_chunks:
        gaps = plan.gaps.among(frames[p] for p in chunk.outer)
        needs = observations(plan, graph, chunk.outer)
        own = {"chunk": [chunk.core.start, chunk.core.stop], "absent": sorted(gaps.absent)}
        fields = node_fields(plan, CONFIDENCE, settings, node_keys(needs), **own)
        core = tuple(frames[p] for p in chunk.core)
        yield Node(CONFIDENCE, chunk.index, core, fields, ids(needs), ConfidenceTask(chunk.outer, gaps))


def observations(plan: ShotPlan, graph: Graph, loaded: Span) -> list[Node]:
    """Nodes of the observed materials and of the flow that a span of frames is solved from."""
    frames = [plan.job.frames[p] for p in loaded]
    found = [graph.committer(plan.observed, frame) for frame in frames if frame not in plan.absent]
    return found + [graph.committer(FLOW, frame) for frame in frames[:-1] if frame not in plan.unlinked]
