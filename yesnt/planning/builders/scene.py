"""Nodes of a scene of Blender: the map that is baked from it, and its plates with and without the subject."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from yesnt.blender_set.settings import QUALITIES
from yesnt.core.scene_input import has_world
from yesnt.io.records import SharedSettings
from yesnt.planning.builders.assemble import frame_keys, frame_node, ids, node_fields
from yesnt.planning.builders.sides import sides_of
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import BAKE, MESH, RELIGHT, SET, SOLVE
from yesnt.planning.task_records import BakeTask, SceneTask


def bake_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """The environment map of a job with `light: set`."""
    scene, proxy = plan.job.shot.scene, plan.job.shot.proxy
    if scene is None or proxy is None or not plan.job.shot.light.set:
        return
    frames = plan.job.probe_frames
    inputs = {f"probe proxy {frame}": plan.inputs(frame, proxy=proxy.path)["proxy"] for frame in frames}
    inputs |= plan.inputs(frames[0], scene=scene)
    settings = _settings(plan, "bake")
    fields = node_fields(plan, BAKE, settings, inputs=inputs, frame=frames[0])
    made = [node for node in graph if node.stage == MESH]  # proxies that come from Gaussian fields
    yield Node(BAKE, 0, frames[:1], fields, ids(made), BakeTask(frames))


def scene_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """The plates of every delivered frame; none without a scene."""
    shot = plan.job.shot
    if shot.scene is None or shot.proxy is None:
        return
    settings = _settings(plan, "set")
    world = shot.light.path if not has_world(shot.scene) else None
    for frame in plan.delivered:
        inputs = plan.plate_inputs(frame) | plan.inputs(
            frame, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path, camera=shot.camera, scene=shot.scene,
            light=world,
        )  # fmt: skip
        turn = {"light": changed_keys(shot.light.at(frame), {"path"})} if world else {}
        upstream = frame_keys(graph, frame, [SOLVE, RELIGHT])
        sides = sides_of(plan, frame)
        own = {"inputs": inputs | sides.inputs, "frame": frame, **turn, **sides.fields}
        fields = node_fields(plan, SET, settings, upstream, **own)
        needs = [graph.committer(stage, frame) for stage in (SOLVE, RELIGHT)]
        yield frame_node(plan, SET, frame, fields, SceneTask(sides.cameras), needs)


def _settings(plan: ShotPlan, what: str) -> SharedSettings:
    """What the pictures of a scene depend on beside its own file and the frame."""
    facts, shot = plan.job.scene, plan.job.shot
    assert facts is not None, "resolved with the job"
    assert shot.set is not None, "only jobs with a scene"
    assert shot.proxy is not None, "a set needs a proxy"
    quality = QUALITIES[shot.quality]
    own: dict[str, Any] = {"plate": plan.plate_settings, "gbuffer": changed_keys(shot.gbuffer, {"path"})}
    return shared(
        scene=changed_keys(shot.set, {"blend", "mode"}),
        files=[plan.digests[path] for path in facts.files],
        blender=facts.version,
        samples=changed_fields(quality),
        proxy=changed_keys(shot.proxy, {"path"}),
        color=plan.job.colors.digests("scene", "to_scene"),
        working=shot.color.working,
        **(own if what == "set" else {}),
    )
