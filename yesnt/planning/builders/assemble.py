"""Puts a node together: the fields that make its key, and the nodes that it needs."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from yesnt.core.stage_id import StageId
from yesnt.io.records import SharedSettings, digest_of_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import stage_of
from yesnt.planning.task_records import TaskRecord

Upstream = Mapping[str, str]
"""Label of a stage -> key of what is taken from it."""


def node_fields(
    plan: ShotPlan, stage: StageId, settings: SharedSettings, upstream: Upstream | None = None, **own: Any
) -> dict[str, Any]:
    """Everything that a node's result depends on.

    Args:
        plan: the shot.
        stage: of the node.
        settings: that all nodes of the stage share.
        upstream: keys of what it takes from other nodes.
        own: what else distinguishes the node, such as `inputs`: digests of its files by role.
    """
    return {
        "stage": stage.label,
        "version": stage_of(stage).version,
        "size": [plan.job.width, plan.job.height],
        **_raster(plan),
        "settings": settings,
        **own,
        "upstream": upstream or {},
    }


def _raster(plan: ShotPlan) -> dict[str, Any]:
    """What the results of all stages depend on of a raster that is not simply the camera's."""
    raster = plan.job.raster
    if raster is None:
        return {}
    left, top = raster.data.left, raster.data.top
    moved = [left, top, raster.camera.left - raster.display.left, raster.camera.top - raster.display.top]
    found = {"window": moved if any(moved) else [], "aspect": [raster.aspect] if raster.aspect != 1 else []}
    return {name: value for name, value in {**found, "read as": list(raster.readings)}.items() if value}


def frame_node(
    plan: ShotPlan,
    stage: StageId,
    frame: int,
    fields: Mapping[str, Any],
    task: TaskRecord,
    needs: Sequence[Node] = (),
) -> Node:
    """A node that commits one frame. Its index counts frames that are left out too: what made them keeps its own."""
    return Node(stage, bisect_left(plan.job.all_but(), frame), (frame,), fields, ids(needs), task)


def ids(nodes: Iterable[Node]) -> tuple[Any, ...]:
    """Identifiers of nodes, each once."""
    return tuple(dict.fromkeys(node.id for node in nodes))


def frame_keys(graph: Graph, frame: int, stages: Iterable[StageId]) -> dict[str, str]:
    """Keys of one frame in other stages."""
    return {stage.label: graph.committer(stage, frame).frame_key(frame) for stage in stages}


def node_keys(nodes: Iterable[Node]) -> dict[str, str]:
    """One key for all nodes of a stage: that of the only one, or a digest of all in order."""
    by_stage: dict[str, list[str]] = {}
    for node in nodes:
        by_stage.setdefault(node.stage.label, []).append(node.key)
    return {stage: keys[0] if len(keys) == 1 else digest_of_keys(keys) for stage, keys in by_stage.items()}
