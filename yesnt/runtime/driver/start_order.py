"""The nodes that are ready, in the order in which they should start."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence

from yesnt.planning.graph import Graph, NodeId

Place = tuple[int, int, int]


class ReadyNodes:
    """Priority queue of nodes whose needs are done.

    Late stages go first, to finish frames early; then the frame that is wanted first. Stages of equal depth (flow and
    decomposition) alternate frame by frame, so that a worker reads each plate once.

    Args:
        graph: all nodes.
        users: node -> the nodes that need it.
        order: frames in the order in which they are wanted; empty: ascending. A node is wanted as early as the first
            frame that needs it.
    """

    def __init__(self, graph: Graph, users: Mapping[NodeId, Sequence[NodeId]], order: Sequence[int] = ()) -> None:
        self._place = _places(graph, users, order)
        self._heaps: dict[str, list[tuple[Place, NodeId]]] = {}
        self._removed: set[NodeId] = set()

    def push(self, node_id: NodeId) -> None:
        """Adds a node."""
        heapq.heappush(self._heaps.setdefault(node_id[0].name, []), (self._place[node_id], node_id))

    def pop(self, admit: Callable[[str], bool]) -> NodeId | None:
        """Removes the first node whose stage may start a task; None if there is none.

        Args:
            admit: whether one task of a stage may start; asked for the stage that would be next, until one may.
        """
        for name in sorted((name for name, heap in self._heaps.items() if self._tidy(heap)), key=self._first):
            if admit(name):
                return heapq.heappop(self._heaps[name])[1]
        return None

    def stages(self) -> list[str]:
        """Stages of which a node is ready."""
        return [name for name, heap in self._heaps.items() if heap]

    def remove(self, node_id: NodeId) -> None:
        """Makes sure that a node does not start, whether it is ready or not."""
        self._removed.add(node_id)

    def _first(self, name: str) -> Place:
        return self._heaps[name][0][0]

    def _tidy(self, heap: list[tuple[Place, NodeId]]) -> bool:
        """Drops removed nodes at the head of a heap; whether a node is left."""
        while heap and heap[0][1] in self._removed:
            heapq.heappop(heap)
        return bool(heap)


def _places(graph: Graph, users: Mapping[NodeId, Sequence[NodeId]], order: Sequence[int]) -> dict[NodeId, Place]:
    depth: dict[NodeId, int] = {}
    for node in graph:
        depth[node.id] = 1 + max((depth[need] for need in node.needs), default=0)
    wanted = _ranks(graph, users, order) if order else {node.id: node.frames[0] for node in graph}
    return {node.id: (-depth[node.id], wanted[node.id], i) for i, node in enumerate(graph)}


def _ranks(graph: Graph, users: Mapping[NodeId, Sequence[NodeId]], order: Sequence[int]) -> dict[NodeId, int]:
    """Place of each node's first user in the order of frames; frames that are not in it come last."""
    place = {frame: i for i, frame in enumerate(order)}
    ranks: dict[NodeId, int] = {}
    for node in reversed(list(graph)):
        later = [ranks[user] for user in users[node.id]]
        ranks[node.id] = min(later) if later else min(place.get(frame, len(order)) for frame in node.frames)
    return ranks
