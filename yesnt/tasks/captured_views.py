"""Reads the pictures of the capture's cameras that a task measures materials by."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from yesnt.capture.files import camera_files
from yesnt.capture.pictures import read_view
from yesnt.decompose.evidence.records import View
from yesnt.io.calibrations.registry import calibration_files
from yesnt.io.cameras import CalibratedCamera, World, calibration_path, calibration_roles, read_cameras
from yesnt.planning.task_records import MeasureTask, SidesTask
from yesnt.tasks.inputs import prove_input
from yesnt.tasks.workspace import Workspace


def captured_views(space: Workspace[MeasureTask | SidesTask]) -> list[View]:
    """Pictures of the task's cameras, each proved to be the file that the node's key names."""
    job, frame, known = space.job, space.frame, space.node.inputs
    capture = job.shot.captured
    assert capture is not None
    roles = calibration_roles(job.root, capture)
    digests = tuple(known[role] for role in roles)
    calibrated = _cameras(calibration_path(job.root, capture), World(capture.up, capture.units), digests)
    views = []
    with space.clock.reading_time():
        for name in space.task.cameras:
            views.append(read_view(job, name, calibrated[name], frame))
            for role, path in camera_files(job.root, capture, name, frame).items():
                prove_input(path, known[f"{role} {name}"])
    return views


@lru_cache(maxsize=2)
def _cameras(path: Path, world: World, digests: tuple[str, ...]) -> Mapping[str, CalibratedCamera]:
    """The cameras of a calibration whose files have these digests."""
    found = read_cameras(path, world)
    for file, digest in zip(calibration_files(path), digests, strict=True):
        prove_input(file, digest)
    return found
