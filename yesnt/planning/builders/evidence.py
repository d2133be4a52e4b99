"""Nodes of the evidence: materials measured by the capture's cameras; none for a job without a capture."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from yesnt.capture.files import camera_files
from yesnt.core.shot import Shot
from yesnt.io.cameras import calibration_roles
from yesnt.io.records import SharedSettings
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_node, node_fields, node_keys
from yesnt.planning.builders.relight import probe_inputs, probe_settings
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, picture_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import DECOMPOSE, EVIDENCE, FLOW
from yesnt.planning.task_records import CarryEvidenceTask, MeasureTask, TrackTask

READS = (
    "brdf", "diffuse", "capture_texels", "capture_clusters", "rows", "detail", "rays", "error", "offset",
)  # fmt: skip
"""Settings of relighting that the responses of the capture light depend on."""

CARRY_READS = ("least_views", "roughness_error", "metallic_error")
"""Settings of the evidence that a frame depends on which takes another's materials."""


def evidence_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Frames that are measured, then those that take the result of a later one along the flow."""
    if not plan.views and not plan.moments:
        return
    carried = {f: key for f, key in plan.evidence_keyframes.items() if f in plan.present}
    measure = _tracked_node if plan.moments else _measured_node
    yield from (measure(plan, graph, frame) for frame in plan.present if frame not in carried)
    yield from (_carried_node(plan, graph, frame, keyframe) for frame, keyframe in carried.items())


def _measured_node(plan: ShotPlan, graph: Graph, frame: int) -> Node:
    """One frame with its cameras; a frame that its keyframe cannot reach has none and keeps the model's estimate."""
    shot, names = plan.job.shot, plan.views.get(frame, ())
    assert shot.captured is not None
    inputs = plan.plate_inputs(frame) | plan.inputs(
        frame, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path if shot.proxy else None, camera=shot.camera,
        capture=shot.capture_light.path if shot.capture_light else None,
    )  # fmt: skip
    root = plan.job.root
    inputs |= {role: plan.digests[str(path)] for role, path in calibration_roles(root, shot.captured).items()}
    for name in names:
        files = camera_files(root, shot.captured, name, frame)
        inputs |= {f"{role} {name}": plan.digests[str(path)] for role, path in files.items()}
    decomposed = graph.committer(DECOMPOSE, frame)
    fields = node_fields(
        plan, EVIDENCE, _settings(plan, frame), node_keys([decomposed]), inputs=inputs | probe_inputs(plan)
    )
    return frame_node(plan, EVIDENCE, frame, fields, MeasureTask(names), [decomposed])


def _tracked_node(plan: ShotPlan, graph: Graph, frame: int) -> Node:
    """One frame with the others that show the same points, and the flow between them."""
    shot, moments, job = plan.job.shot, plan.moments[frame], plan.job
    inputs = plan.inputs(frame, camera=shot.camera) | probe_inputs(plan)
    for one in (frame, *moments):
        files = plan.plate_inputs(one) | plan.inputs(
            one, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path if shot.proxy else None,
            capture=shot.capture_light.path if shot.capture_light else None,
        )  # fmt: skip
        inputs |= files if one == frame else {f"{role} {one}": digest for role, digest in files.items()}
    reached = (frame, *moments)
    way = job.frames[job.position(min(reached)) : job.position(max(reached))]
    needs = [graph.committer(DECOMPOSE, frame), *(graph.committer(FLOW, one) for one in way)]
    capture = shot.capture_light
    lights = [changed_keys(capture.at(one), {"path"}) for one in reached] if capture and moments else []
    settings = SharedSettings(_settings(plan, frame), moments=[one - frame for one in moments], lights=lights)
    fields = node_fields(plan, EVIDENCE, settings, node_keys(needs), inputs=inputs)
    return frame_node(plan, EVIDENCE, frame, fields, TrackTask(moments), needs)


def _settings(plan: ShotPlan, frame: int) -> SharedSettings:
    shot, colors = plan.job.shot, plan.job.colors
    capture = shot.capture_light.at(frame) if shot.capture_light else None
    return shared(
        evidence=changed_fields(of.evidence_settings(shot)),
        relight=relight_read(shot),
        capture=changed_keys(capture, {"path"}) if capture else None,
        pictures=picture_keys(shot.captured) if shot.captured else None,
        gbuffer=changed_keys(shot.gbuffer, {"path"}),
        proxy=changed_keys(shot.proxy, {"path"}) if shot.proxy else None,
        **plan.plate_settings | {"color": colors.digests("plate_working", "capture_light", "capture")},
        working=changed_keys(shot.color, {"config", "output", "view"}),
        **probe_settings(plan),
    )


def relight_read(shot: Shot) -> dict[str, Any]:
    """Settings of relighting that the evidence depends on, where they differ from their defaults."""
    return {name: value for name, value in changed_fields(of.relight_settings(shot)).items() if name in READS}


def _carried_node(plan: ShotPlan, graph: Graph, frame: int, keyframe: int) -> Node:
    """A frame between: the keyframe's materials along the flow, and what looks like them where it does not reach."""
    job = plan.job
    way = job.frames[job.position(frame) : job.position(keyframe)]
    needs = [graph.committer(DECOMPOSE, frame), graph.committer(EVIDENCE, keyframe)]
    needs += [graph.committer(FLOW, one) for one in way]
    weighed = changed_fields(of.evidence_settings(job.shot))
    reads = {name: value for name, value in weighed.items() if name in CARRY_READS}
    settings = shared(evidence=reads, **plan.plate_settings)
    fields = node_fields(plan, EVIDENCE, settings, node_keys(needs), inputs=plan.plate_inputs(frame))
    return frame_node(plan, EVIDENCE, frame, fields, CarryEvidenceTask(keyframe), needs)
