"""Checks of a job that is rendered from Gaussian fields, before anything is made."""

from __future__ import annotations

from typing import Any

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.io.gaussian_ply import read_field
from yesnt.io.jobfile import frame_path

LEAST_SHARE = 0.01
"""Share of the Gaussians that the camera must have in its picture."""


def check_views(job: Job, camera: Camera) -> None:
    """Refuses a camera that fields cannot be rendered for.

    Raises:
        JobError: its lens distorts.
    """
    shot = job.shot
    if not {shot.plate.path, shot.gbuffer.path} & set(shot.made):
        return
    for frame in job.frames:
        lens = camera.lens(frame)
        if lens.distortion.acts:
            raise JobError(
                f"A Gaussian field is rendered without distortion, and the camera's lens has the model "
                f"{lens.distortion.model!r} in frame {frame}",
                f"{shot.camera}, key distortion", '"model": "none"',
                "take the distortion out of the camera, and distort the delivered pictures",
            )  # fmt: skip


def check_field(job: Job, frame: int) -> list[Any]:
    """Reads a frame's field; returns nothing that is odd.

    Raises:
        JobError: it cannot be read, or the shot's camera sees next to none of it.
    """
    assert job.shot.gaussians is not None
    path = frame_path(job.root, job.shot.gaussians.path, frame)
    field, camera = read_field(path), Camera.open(frame_path(job.root, job.shot.camera, 0))
    if not field.count:
        raise JobError("The Gaussian field is empty", str(path), "at least one Gaussian", "fit or export it again")
    x, y, z = camera.project(field.positions, frame).T
    share = ((z > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)).mean()
    if share < LEAST_SHARE:
        raise JobError(
            f"The camera sees {100 * share:.2g} % of the Gaussians in frame {frame}", f"{path}; {job.shot.camera}",
            "a field and a camera in one world: metres, Z up",
            "check axes and units of the camera, and that the field was fitted in the same world",
        )  # fmt: skip
    return []
