"""The evaluation in one sentence: the product decomposes and solves a shot as ever, then every map's frames are relit
row by row and judged against the truth, films after all their frames, constants once the best are known."""  # noqa: D205, D209

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import FLOW, SOLVE

if TYPE_CHECKING:
    from yesnt.measure.evaluation.plan import EvalPlan


def evaluation_graph(plan: EvalPlan) -> Graph:
    """All nodes of a shot but those of the constants and of the ladder with own materials, needs first."""
    return Graph(node for node in _nodes(plan) if node.stage.name != "steps")


def ladder_graph(plan: EvalPlan) -> Graph:
    """The ladder with own materials, which comes after all shots have their main rows, and what it needs."""
    graph = Graph(_nodes(plan))
    return graph.closure([node.id for node in graph if node.stage.name == "steps"])


def constants_graph(plan: EvalPlan, constants: Mapping[str, tuple[float, float]]) -> Graph:
    """The rows of constant materials, once the search of all shots is over."""
    return Graph(plan.flat(name, frame, constants) for name, _ in plan.subject.maps for frame in plan.judged(name))


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
    if plan.exact_arrays:
        yield add(plan.exact(graph))
    names = [name for name, _ in plan.subject.maps]
    yield from (add(plan.search(name, graph)) for name in plan.probed)
    # Frame by frame and then map by map: a frame's scene stays in its worker.
    for frame in plan.frames:
        yield from (add(plan.given(name, frame, graph)) for name in names if frame in plan.judged(name))
        proxies = (n for n in names if frame in plan.judged(n) and "blender_proxy" not in plan.absent(n))
        yield from (add(plan.reference(name, frame, graph)) for name in proxies)
        filmed = (name for name in names if plan.filmed(name) or frame in plan.judged(name))
        yield from (add(plan.judge(name, frame, graph)) for name in filmed)
    if not plan.lacking:
        climbed = [(name, frame) for name in plan.probed for frame in plan.judged(name)]
        yield from (add(plan.steps(name, frame, graph)) for name, frame in climbed)
    yield from (add(plan.bounces(name, graph)) for name in names if plan.early(name))
    yield from (add(plan.film(name, graph)) for name in names if plan.filmed(name))
