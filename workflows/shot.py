"""The product in one sentence, as a graph.

Mattes of a capture that brings none are made first, then what a job takes from Gaussian fields. Keyframes, or windows
of frames, are decomposed; flow links each frame to the next; frames between keyframes take their
keyframe's materials along the flow and sample what is missing; the cameras of a capture measure the materials;
corrections by the artist are applied; each frame's confidence is weighed and the shot is solved along the flow, in
chunks if it is long; the ground under the subject is found; each frame is relit as soon as it is solved, then the set
around it is lit, and both are composited.
"""

from __future__ import annotations

from yesnt.planning.builders.composite import composite_nodes, compositing_nodes
from yesnt.planning.builders.confidence import confidence_nodes
from yesnt.planning.builders.correct import correct_nodes
from yesnt.planning.builders.decompose import full_frame_nodes, in_between_nodes, window_nodes
from yesnt.planning.builders.evidence import evidence_nodes
from yesnt.planning.builders.flow import flow_nodes
from yesnt.planning.builders.gaussians import gaussian_nodes
from yesnt.planning.builders.ground import ground_nodes
from yesnt.planning.builders.matte import after_made, matte_nodes
from yesnt.planning.builders.preview import preview_nodes, segment_nodes
from yesnt.planning.builders.relight import relight_nodes
from yesnt.planning.builders.scene import bake_nodes, scene_nodes
from yesnt.planning.builders.set_stage import set_nodes
from yesnt.planning.builders.solve import solve_nodes
from yesnt.planning.graph import Graph
from yesnt.planning.shot_plan import MATTES, ShotPlan


def shot_graph(plan: ShotPlan) -> Graph:
    """All nodes of a shot, needs first."""
    graph = Graph()
    graph.extend(matte_nodes(plan))
    if plan.awaiting == MATTES:
        return graph
    graph.extend(after_made(graph, gaussian_nodes(plan)))
    if plan.awaiting:
        return graph
    graph.extend(after_made(graph, window_nodes(plan)))
    graph.extend(after_made(graph, full_frame_nodes(plan, graph)))
    graph.extend(after_made(graph, flow_nodes(plan)))
    graph.extend(after_made(graph, in_between_nodes(plan, graph)))
    graph.extend(after_made(graph, evidence_nodes(plan, graph)))
    graph.extend(after_made(graph, correct_nodes(plan, graph)))
    graph.extend(confidence_nodes(plan, graph))
    graph.extend(solve_nodes(plan, graph))
    graph.extend(after_made(graph, ground_nodes(plan, graph)))
    graph.extend(bake_nodes(plan, graph))
    graph.extend(after_made(graph, relight_nodes(plan, graph)))
    graph.extend(after_made(graph, set_nodes(plan, graph)))
    graph.extend(after_made(graph, scene_nodes(plan, graph)))
    graph.extend(composite_nodes(plan, graph))
    graph.extend(compositing_nodes(plan))
    graph.extend(segment_nodes(plan, graph))
    graph.extend(preview_nodes(plan, graph))
    return graph
