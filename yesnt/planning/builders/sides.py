"""What a node of the set depends on where cameras of the capture show sides of the subject that the plate does not."""

from __future__ import annotations

from typing import Any, NamedTuple

from yesnt.capture.files import camera_files
from yesnt.io.cameras import calibration_roles
from yesnt.planning import settings as of
from yesnt.planning.builders.evidence import relight_read
from yesnt.planning.builders.relight import probe_inputs
from yesnt.planning.keyed_settings import changed_fields, changed_keys, picture_keys
from yesnt.planning.shot_plan import ShotPlan


class Sides(NamedTuple):
    """Of one frame.

    Attributes:
        cameras: names; none where unseen sides take the materials of those that are seen.
        inputs: digests of their files by role.
        fields: what else the result depends on.
    """

    cameras: tuple[str, ...]
    inputs: dict[str, str]
    fields: dict[str, Any]


def sides_of(plan: ShotPlan, frame: int) -> Sides:
    """Cameras that measure the subject's unseen sides for its set: in all frames or in none, lest they flicker."""
    shot, root = plan.job.shot, plan.job.root
    if shot.set is None or shot.captured is None or not shot.set.shows_sides:
        return Sides((), {}, {})
    if not plan.views or any(f not in plan.views for f in plan.delivered):
        return Sides((), {}, {})
    names, light = plan.views[frame], shot.capture_light
    paths = dict(calibration_roles(root, shot.captured))
    for name in names:
        files = camera_files(root, shot.captured, name, frame)
        paths |= {f"{role} {name}": path for role, path in files.items()}
    inputs = {role: plan.digests[str(path)] for role, path in paths.items()} | probe_inputs(plan)
    inputs |= plan.inputs(frame, capture=light.path if light else None)
    fields = {
        "evidence": changed_fields(of.evidence_settings(shot)),
        "relight": relight_read(shot),
        "capture": changed_keys(light.at(frame), {"path"}) if light else {},
        "pictures": picture_keys(shot.captured),
        "color": plan.job.colors.digests("plate_working", "capture_light", "capture"),
    }
    return Sides(names, inputs, {"sides": fields})
