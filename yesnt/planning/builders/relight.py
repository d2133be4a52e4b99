"""Nodes of relighting: one for each delivered frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from yesnt.capture.files import camera_files
from yesnt.capture.plan import light_probes
from yesnt.core.shot import CaptureInput, LightInput, Shot
from yesnt.io.cameras import calibration_roles
from yesnt.io.records import SharedSettings
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import frame_keys, frame_node, node_fields, node_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys, picture_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import BAKE, EVIDENCE, GROUND, RELIGHT, SOLVE
from yesnt.planning.task_records import RelightTask

SURROUNDINGS = 3
"""Version of the light that a set sends to the subject; raised in place of the stage's, which all jobs share."""


def relight_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Every frame with the capture light divided out and the new light applied."""
    settings, probes = _SettingsByFrame(plan), probe_inputs(plan)
    shot, first = plan.job.shot, plan.job.frames[0]
    once = (*((GROUND,) if shot.built_in_set else ()), *((BAKE,) if shot.light.set else ()))
    of_shot = [graph.committer(stage, first) for stage in once]
    of_frame = (SOLVE, EVIDENCE) if plan.base_from_views else (SOLVE,)
    for frame in plan.delivered:
        inputs = _frame_inputs(plan, frame) | probes
        upstream = frame_keys(graph, frame, of_frame) | node_keys(of_shot)
        fields = node_fields(plan, RELIGHT, settings.of(frame), upstream, inputs=inputs)
        needs = [*(graph.committer(stage, frame) for stage in of_frame), *of_shot]
        yield frame_node(plan, RELIGHT, frame, fields, RelightTask(plan.base_from_views), needs)


class _SettingsByFrame:
    """Settings of the frames: frames under the same light share theirs, however the job gives it."""

    def __init__(self, plan: ShotPlan) -> None:
        self._shot, self._plate, self._made = plan.job.shot, plan.plate_settings, dict[Any, SharedSettings]()
        self._color = plan.job.colors.digests("plate_working", "light", "capture_light")
        self._probes = probe_settings(plan)

    def of(self, frame: int) -> SharedSettings:
        """The settings of a frame, with the light and the capture light as they are then."""
        shot = self._shot
        lights = shot.light.at(frame), shot.capture_light.at(frame) if shot.capture_light else None
        if lights not in self._made:
            self._made[lights] = _settings(shot, *lights, self._plate | {"color": self._color} | self._probes)
        return self._made[lights]


def _settings(shot: Shot, light: LightInput, capture: CaptureInput | None, plate: Mapping[str, Any]) -> SharedSettings:
    return shared(
        relight=changed_fields(of.relight_settings(shot)),
        light=changed_keys(light, {"path"}),
        capture=changed_keys(capture, {"path"}) if capture else None,
        gbuffer=changed_keys(shot.gbuffer, {"path"}),
        proxy=changed_keys(shot.proxy, {"path"}) if shot.proxy else None,
        set=changed_keys(shot.built_in_set, {"mesh", "mode"}) | {"version": SURROUNDINGS}
        if shot.built_in_set
        else None,
        sun=True if shot.light_groups else None,
        **plate,
    )


def _frame_inputs(plan: ShotPlan, frame: int) -> dict[str, str]:
    shot = plan.job.shot
    return plan.plate_inputs(frame) | plan.inputs(
        frame, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path if shot.proxy else None,
        light=shot.light.path, capture=shot.capture_light.path if shot.capture_light else None, camera=shot.camera,
        mesh=shot.built_in_set.mesh if shot.built_in_set else None,
    )  # fmt: skip


def probe_inputs(plan: ShotPlan) -> dict[str, str]:
    """Files of the frames that the capture light is estimated from; none if it is given."""
    shot, found = plan.job.shot, dict[str, str]()
    if shot.capture_light is None or not shot.capture_light.estimate:
        return found
    if plan.views:
        return _camera_probes(plan)
    for frame in plan.job.probe_frames:
        seen = plan.plate_inputs(frame) | plan.inputs(frame, gbuffer=shot.gbuffer.path)
        found |= {f"probe {role} {frame}": digest for role, digest in seen.items()}
    return found


def _camera_probes(plan: ShotPlan) -> dict[str, str]:
    """The same where the capture's cameras tell of the light (tasks/estimated_light.py)."""
    shot, root = plan.job.shot, plan.job.root
    assert shot.captured is not None
    assert shot.proxy is not None
    found = {f"probe {role}": plan.digests[str(path)] for role, path in calibration_roles(root, shot.captured).items()}
    for frame, names in light_probes(plan.views).items():
        seen = plan.plate_inputs(frame) | plan.inputs(frame, proxy=shot.proxy.path)
        found |= {f"probe {role} {frame}": digest for role, digest in seen.items()}
        for name in names:
            files = camera_files(root, shot.captured, name, frame)
            found |= {f"probe {role} {name} {frame}": plan.digests[str(path)] for role, path in files.items()}
    return found


def probe_settings(plan: ShotPlan) -> dict[str, Any]:
    """Settings that the capture's pictures are read by, where the capture light is estimated from them."""
    shot = plan.job.shot
    if not plan.views or shot.captured is None or shot.capture_light is None or not shot.capture_light.estimate:
        return {}
    pictures = picture_keys(shot.captured)
    return {"light_from": {"version": 1, "pictures": pictures, "color": plan.job.colors.digests("capture")}}
