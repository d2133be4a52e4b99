"""The evaluation of a shot: it is decomposed and solved, then relit and scored against the truth, row by row.

Videos are scored after all their frames, rows of constant materials after the best constants are known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import FLOW, SOLVE

if TYPE_CHECKING:
    from yesnt.measure.evaluation.plan import EvalPlan
    from yesnt.runtime.session import Session


def evaluation_graph(plan: EvalPlan) -> Graph:
    """All nodes of a shot except constant materials and term-by-term rows with own materials, in order of need."""
    return Graph(node for node in _nodes(plan) if node.stage.name != "ablation")


def ablation_graph(plan: EvalPlan) -> Graph:
    """The term-by-term rows with own materials and what they need; run after the main rows of all shots."""
    graph = Graph(_nodes(plan))
    return graph.closure([node.id for node in graph if node.stage.name == "ablation"])


def constants_graph(plan: EvalPlan, constants: Mapping[str, tuple[float, float]]) -> Graph:
    """The rows of constant materials; run after the search for the best constants of all shots."""
    scored = [(name, frame) for name, _ in plan.subject.maps for frame in plan.scored_frames(name)]
    return Graph(plan.constant_rows(name, frame, constants) for name, frame in scored)


def materials_graph(session: Session) -> Graph:
    """The product's own nodes up to the solved materials."""
    product = session.graph()
    return product.closure([node.id for node in product if node.stage == SOLVE])


def measured_graph(plan: EvalPlan) -> Graph:
    """The rows whose materials a capture measured; run after the jobs that measure them."""
    scored = [(name, frame) for frame in plan.frames for name, _ in plan.subject.maps]
    found = [plan.measured_score(name, frame) for name, frame in scored if frame in plan.scored_frames(name)]
    videos = [plan.measured_video(name) for name, _ in plan.subject.maps if plan.has_video(name)]
    return Graph([plan.measured_material(), *found, *videos])


def fitted_graph(plan: EvalPlan) -> Graph:
    """The rows whose geometry is fitted; run after the job that fits it."""
    scored = [(name, frame) for frame in plan.frames for name, _ in plan.subject.maps]
    there = [(name, frame) for name, frame in scored if frame in plan.scored_frames(name)]
    rendered = [plan.fitted_reference(name, frame) for name, frame in there]
    return Graph([*(plan.fitted_score(name, frame) for name, frame in there), *filter(None, rendered)])


def _nodes(plan: EvalPlan) -> Iterator[Node]:
    graph = Graph()

    def add(node: Node) -> Node:
        graph.extend([node])
        return node

    if not plan.lacking:
        product = plan.session.graph()
        wanted = [node.id for node in product if node.stage in (SOLVE, FLOW)]
        for node in product.closure(wanted):
            yield add(node)
        yield add(plan.material(graph))
    if plan.true_solves:
        yield add(plan.solve_true(graph))
    names = [name for name, _ in plan.subject.maps]
    yield from (add(plan.search(name, graph)) for name in plan.probe_maps)
    # Frame by frame and then map by map: the inputs of a frame stay in the worker's cache.
    for frame in plan.frames:
        yield from (add(plan.independent(name, frame, graph)) for name in names if frame in plan.scored_frames(name))
        proxies = (n for n in names if frame in plan.scored_frames(n) and "blender_proxy" not in plan.absent(n))
        yield from (add(plan.reference(name, frame, graph)) for name in proxies)
        scored = (name for name in names if plan.has_video(name) or frame in plan.scored_frames(name))
        yield from (add(plan.score(name, frame, graph)) for name in scored)
    if not plan.lacking:
        probed = [(name, frame) for name in plan.probe_maps for frame in plan.scored_frames(name)]
        yield from (add(plan.ablation(name, frame, graph)) for name, frame in probed)
    yield from (add(plan.bounces(name, graph)) for name in names if plan.early(name))
    yield from (add(plan.video(name, graph)) for name in names if plan.has_video(name))
