"""Nodes that make mattes from the capture's pictures; none for a job that brings its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from yesnt.capture.files import MATTE as MATTE_FILE
from yesnt.capture.files import VIEW, camera_files
from yesnt.capture.person import model_files
from yesnt.capture.samples import background_files
from yesnt.core.capture_input import CaptureCameras
from yesnt.io.cameras import calibration_roles, cameras_of
from yesnt.io.records import SharedSettings
from yesnt.planning.builders.assemble import frame_node, node_fields, node_keys
from yesnt.planning.builders.gaussians import after_views
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_keys, picture_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import MATTE, background_stage
from yesnt.planning.task_records import BackgroundTask, MatteTask


def matte_nodes(plan: ShotPlan) -> Iterator[Node]:
    """The background of every camera, then the mattes of all cameras in every frame."""
    capture = plan.job.shot.matted
    if capture is None:
        return
    names = tuple(cameras_of(plan.job.root, capture))
    backgrounds = [node for number, name in enumerate(names) for node in _background(plan, capture, number, name)]
    yield from backgrounds
    settings = _settings(plan, capture)
    for frame in plan.job.all_but(MATTE.name):
        inputs = _common(plan, capture)
        for name in names:
            inputs[f"{VIEW} {name}"] = plan.digests[str(camera_files(plan.job.root, capture, name, frame)[VIEW])]
        fields = node_fields(plan, MATTE, settings, node_keys(backgrounds), inputs=inputs)
        yield frame_node(plan, MATTE, frame, fields, MatteTask(names), backgrounds)


def _background(plan: ShotPlan, capture: CaptureCameras, number: int, name: str) -> Iterator[Node]:
    """The node of one camera's background; none where pictures are not compared with one."""
    files = background_files(plan.job, name)
    if files:
        inputs = _common(plan, capture) | {role: plan.digests[str(path)] for role, path in files.items()}
        stage = background_stage(number)
        fields = node_fields(plan, stage, _settings(plan, capture, "consistent"), inputs=inputs, camera=name)
        yield Node(stage, 0, plan.job.all_but()[:1], fields, (), BackgroundTask(name))


def _common(plan: ShotPlan, capture: CaptureCameras) -> dict[str, str]:
    """Digests of the calibration and of the models that find persons."""
    files = {**calibration_roles(plan.job.root, capture), **model_files(plan.job)}
    return {role: plan.digests[str(path)] for role, path in files.items()}


def _settings(plan: ShotPlan, capture: CaptureCameras, *without: str) -> SharedSettings:
    """What mattes and backgrounds depend on beside their files."""
    matting = capture.matting
    assert matting is not None
    return shared(
        matting=changed_keys(matting, {"background", "weights", *without}),
        background="clean" if matting.clean_plates else matting.background,
        pictures=picture_keys(capture),
        color=plan.job.colors.digests("capture"),
        working=changed_keys(plan.job.shot.color, {"config", "output", "view"}),
    )


def after_made(graph: Graph, nodes: Iterable[Node]) -> Iterator[Node]:
    """Nodes that read what is made first, with the nodes that make it among their needs: mattes, views, proxies."""
    makes = MATTE in graph.stages
    for node in after_views(graph, nodes):
        if makes and any(f"{MATTE_FILE} " in role for role in node.inputs):
            made = tuple(graph.committer(MATTE, frame).id for frame in node.frames)
            yield replace(node, needs=tuple(dict.fromkeys((*node.needs, *made))))
        else:
            yield node
