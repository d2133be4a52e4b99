"""Nodes of a workflow: what is to be made, from what, under which key. Plain data; nothing runs here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from yesnt.core.stage_id import StageId
from yesnt.io.records import frame_key, key_of
from yesnt.planning.task_records import TaskRecord

NodeId = tuple[StageId, int]
"""Stage and index in that stage (position of a frame, or number of a chunk)."""


NOTHING = TaskRecord()
"""Arguments of a task that needs only the job."""


@dataclass(frozen=True)
class Node:
    """One task: idempotent, small enough to send, its result determined by `fields`.

    Attributes:
        stage: the stage whose records it commits.
        index: position of the frame, or number of the chunk.
        frames: frame numbers that it commits, each with a record of its own.
        fields: everything that the result depends on, keys of other nodes included; see `key_of`.
        needs: nodes that must be done before.
        task: the task's arguments besides the job; their type selects the function that runs it.
        transient: its result serves only the nodes that need it, and is removed once they are done.
    """

    stage: StageId
    index: int
    frames: tuple[int, ...]
    fields: Mapping[str, Any]
    needs: tuple[NodeId, ...] = ()
    task: TaskRecord = NOTHING
    transient: bool = False

    @cached_property
    def id(self) -> NodeId:
        """Stage and index."""
        return (self.stage, self.index)

    @cached_property
    def key(self) -> str:
        """Hash of everything that the result depends on."""
        return key_of(self.fields)

    @property
    def inputs(self) -> Mapping[str, str]:
        """Digests of the input files that the task reads, by role."""
        inputs: Mapping[str, str] = self.fields.get("inputs", {})
        return inputs

    def frame_fields(self, frame: int) -> Mapping[str, Any]:
        """The fields of one frame's record: all frames of a node share its fields."""
        return self.fields if len(self.frames) == 1 else {**self.fields, "frame": frame}

    def frame_key(self, frame: int) -> str:
        """The key of one frame's record; equal to `key_of` of its fields."""
        return self.key if len(self.frames) == 1 else frame_key(self.key, frame)

    def without_needs(self) -> Node:
        """The node as it is sent to a worker: a joint solve of a long shot needs tens of thousands of nodes."""
        return replace(self, needs=())


def stage_counts(ids: Iterable[NodeId]) -> dict[str, int]:
    """Number of nodes by the name of their stage, in order of first appearance."""
    return dict(Counter(stage.name for stage, _ in ids))


class Graph:
    """Nodes in an order in which each comes after all that it needs.

    Args:
        nodes: the nodes, needs first.
    """

    def __init__(self, nodes: Iterable[Node] = ()) -> None:
        self.nodes: dict[NodeId, Node] = {}
        self._committers: dict[StageId, dict[int, Node]] = {}
        self.extend(nodes)

    def extend(self, nodes: Iterable[Node]) -> None:
        """Adds nodes one by one, so that nodes made later may ask for nodes made before.

        Raises:
            ValueError: a node is there already, or one that it needs is not.
        """
        for node in nodes:
            missing = [need for need in node.needs if need not in self.nodes]
            if missing or node.id in self.nodes:
                raise ValueError(f"node {node.id} comes twice or before what it needs: {missing}")
            self.nodes[node.id] = node
            self._committers.setdefault(node.stage, {}).update(dict.fromkeys(node.frames, node))

    def committer(self, stage: StageId, frame: int) -> Node:
        """The node that commits a frame of a stage.

        Raises:
            KeyError: none does.
        """
        return self._committers[stage][frame]

    def __iter__(self) -> Iterator[Node]:
        return iter(self.nodes.values())

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def stages(self) -> tuple[StageId, ...]:
        """Stages in order of first appearance."""
        return tuple(self._committers)

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
