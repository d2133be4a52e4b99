"""A stage as a newcomer would add it: a row of the table, a task record, a builder, a function and a workflow line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from yesnt.core.stage_id import StageId
from yesnt.planning.builders.assemble import frame_keys, frame_node, node_fields
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import SOLVE, Cost, Stage
from yesnt.planning.task_records import TaskRecord
from yesnt.tasks.workspace import Workspace
from yesnt.workflows.shot import shot_graph

TOY = StageId("toy")


@dataclass(frozen=True)
class ToyTask(TaskRecord):
    """Scales the roughness of one frame.

    Attributes:
        factor: what roughness is multiplied with.
    """

    factor: float


ROW = Stage(
    "toy", 1, "frame", "material", Cost(0.1, 1.0, 100, 10, 4, scheduler_seconds=3), "#123456",
    {ToyTask: "tests.planning.toy_stage:scale_roughness"}, channels=("z",), files=("a note",),
)  # fmt: skip


def toy_nodes(plan: ShotPlan, graph: Graph, factor: float = 2.0) -> Iterator[Node]:
    """One node for each delivered frame."""
    for frame in plan.delivered:
        fields = node_fields(plan, TOY, shared(factor=factor), frame_keys(graph, frame, [SOLVE]))
        yield frame_node(plan, TOY, frame, fields, ToyTask(factor), [graph.committer(SOLVE, frame)])


def scale_roughness(space: Workspace[ToyTask]) -> None:
    """Commits the scaled roughness [1, H, W] of one frame."""
    roughness = space.read(SOLVE, "material", space.frame)[:1]
    with space.kernel():
        scaled = np.float32(space.task.factor) * roughness
    space.commit(space.frame, {"z": scaled}, facts={"factor": space.task.factor})


def shot_graph_with_toy(plan: ShotPlan) -> Graph:
    """The product's workflow with one more line."""
    graph = shot_graph(plan)
    graph.extend(toy_nodes(plan, graph))
    return graph
