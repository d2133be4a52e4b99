"""Nodes of the composite: one EXR for each delivered frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from yesnt.core.stage_id import StageId
from yesnt.planning.builders.assemble import frame_keys, frame_node, node_fields
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import COMPOSITE, COMPOSITING, EVIDENCE, RELIGHT, SET
from yesnt.planning.task_records import CompositeTask, CompositingTask


def composite_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """The EXR of every frame."""
    shot = plan.job.shot
    settings = shared(
        name=shot.name,
        exr=changed_keys(shot.exr),
        background=changed_keys(shot.background, {"path"}) if shot.background else "light",
        job=plan.job_digest,
        color=plan.job.colors.digests("output", "background" if shot.background else "light"),
        space=changed_fields(plan.job.colors.output_space),
        set=shot.set.mode if shot.set else None,
        composite=None if shot.composite == "linear" else shot.composite,
        **_header(plan),
    )
    stages: tuple[StageId, ...] = (RELIGHT, plan.observed)
    stages += (EVIDENCE,) if plan.estimated == EVIDENCE and plan.observed != EVIDENCE else ()
    stages += (SET,) if shot.set else ()
    for frame in plan.delivered:
        inputs = plan.inputs(frame, **_backdrop(plan))
        upstream = frame_keys(graph, frame, stages)
        fields = node_fields(plan, COMPOSITE, settings, upstream, inputs=inputs)
        task = CompositeTask(plan.job_digest)
        needs = [graph.committer(stage, frame) for stage in stages]
        yield frame_node(plan, COMPOSITE, frame, fields, task, needs)


def compositing_nodes(plan: ShotPlan) -> Iterator[Node]:
    """The scripts for other programs; none without a set or both light groups, or of a composite in display space."""
    shot = plan.job.shot
    groups = len(shot.light_groups) == 2
    if (shot.set is None and not groups) or shot.composite != "linear":
        return
    settings = shared(
        name=shot.name, frames=[plan.job.frames[0], plan.job.frames[-1]], front=True if shot.scene else None,
        bare=True if shot.set is None else None, groups=True if groups else None, **_header(plan),
    )  # fmt: skip
    fields = node_fields(plan, COMPOSITING, settings)
    yield Node(COMPOSITING, 0, plan.job.frames[:1], fields, (), CompositingTask())


def _header(plan: ShotPlan) -> dict[str, Any]:
    """What the EXR's header takes from the plates' headers, beside what every stage depends on."""
    raster = plan.job.raster
    if raster is None:
        return {}
    display = raster.display
    usual = display == raster.processed and (display.left, display.top) == (0, 0)
    box = None if usual else [display.left, display.top, display.width, display.height]
    return {"display": box, "metadata": list(raster.metadata)}


def _backdrop(plan: ShotPlan) -> dict[str, str | None]:
    """Pattern of the background: a plate, or the light's map as the camera sees it."""
    shot = plan.job.shot
    if shot.set is not None and shot.set.mode == "show":
        return {}
    return {"background": shot.background.path} if shot.background else {"light": shot.light.path}
