"""Nodes of a workflow: what is to be made, from what, under which key. Plain data; nothing runs here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from yesnt.io.records import key_of

NodeId = tuple[str, int]
"""Stage name and index in that stage (position of a frame, or number of a chunk)."""


@dataclass(frozen=True)
class Node:
    """One task: idempotent, small enough to send, its result determined by `fields`.

    Attributes:
        stage: stage name; the task that runs it is looked up by it.
        index: position of the frame, or number of the chunk.
        frames: frame numbers that it commits, each with a record of its own.
        fields: everything that the result depends on, the keys of `needs` included.
        needs: nodes that must be done before.
        arguments: what the task is told beside the job; small.
        transient: its result serves its users only, and is swept away once they are done.
    """

    stage: str
    index: int
    frames: tuple[int, ...]
    fields: Mapping[str, Any]
    needs: tuple[NodeId, ...] = ()
    arguments: Mapping[str, Any] = field(default_factory=dict)
    transient: bool = False

    @property
    def id(self) -> NodeId:
        """Stage and index."""
        return (self.stage, self.index)

    @cached_property
    def key(self) -> str:
        """Hash of everything that the result depends on."""
        return key_of(self.fields)

    def frame_fields(self, frame: int) -> Mapping[str, Any]:
        """What one frame's record holds: a chunk commits several frames under one set of fields."""
        return self.fields if len(self.frames) == 1 else {**self.fields, "frame": frame}

    def frame_key(self, frame: int) -> str:
        """The key of one committed frame."""
        return self.key if len(self.frames) == 1 else key_of(self.frame_fields(frame))


class Graph:
    """Nodes in an order in which each comes after all that it needs.

    Args:
        nodes: the nodes, needs first.
    """

    def __init__(self, nodes: Iterable[Node]) -> None:
        self.nodes: dict[NodeId, Node] = {}
        for node in nodes:
            missing = [need for need in node.needs if need not in self.nodes]
            if missing or node.id in self.nodes:
                raise ValueError(f"node {node.id} comes twice or before what it needs: {missing}")
            self.nodes[node.id] = node

    def __iter__(self) -> Any:
        return iter(self.nodes.values())

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def stages(self) -> tuple[str, ...]:
        """Stage names in order of first appearance."""
        return tuple(dict.fromkeys(stage for stage, _ in self.nodes))

    def closure(self, targets: Sequence[NodeId]) -> Graph:
        """The part of the graph that the targets need, themselves included."""
        wanted, stack = set(targets), list(targets)
        while stack:
            fresh = [need for need in self.nodes[stack.pop()].needs if need not in wanted]
            wanted.update(fresh)
            stack.extend(fresh)
        return Graph(node for node in self if node.id in wanted)

    def users(self) -> dict[NodeId, list[NodeId]]:
        """Node -> the nodes that need it."""
        users: dict[NodeId, list[NodeId]] = {node_id: [] for node_id in self.nodes}
        for node in self:
            for need in node.needs:
                users[need].append(node.id)
        return users
