"""Renders one moment of a shot's Gaussian fields along a camera path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError, UsageError
from yesnt.core.gaussian_input import FIELD
from yesnt.core.job_progress import Progress, no_progress
from yesnt.gaussians.field import GaussianField
from yesnt.io.camera_files.files import write_camera
from yesnt.io.cameras import cameras_of
from yesnt.io.exr import write_exr
from yesnt.io.gaussian_ply import read_field
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.planning.stages import FIT
from yesnt.runtime.session import Session
from yesnt.tasks.gaussians import view_planes


def render_views(
    session: Session,
    frame: int,
    stops: Sequence[str],
    views: int,
    out: Path,
    progress: Progress = no_progress,
) -> list[Path]:
    """Writes `view.0001.exr` and so on, each a plate and G-buffer, and `camera.json`; returns the pictures' paths.

    Args:
        session: of the shot.
        frame: the moment.
        stops: cameras of the capture that the path passes; none: once around the field, from the shot's camera.
        views: pictures along the path.
        out: folder.
        progress: called after each picture.

    Raises:
        JobError: the job has no Gaussian fields, or one cannot be read.
        UsageError: an unknown camera.
    """
    job = session.job
    if job.shot.gaussians is None:
        raise JobError(
            "The job has no Gaussian fields",
            f"{job.root}, key gaussians",
            "`gaussians: {path: field.####.ply}`",
            "add it",
        )
    field = _field(session, frame)
    camera = _path(session, field, frame, stops, views)
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"view.{number:04d}.exr" for number in camera.poses]
    for done, (number, path) in enumerate(zip(camera.poses, files, strict=True), 1):
        write_exr(path, view_planes(field, camera, number))
        progress("Rendering views", done, views)
    write_camera(out / "camera.json", camera, "yesnt gof render")
    return files


def _field(session: Session, frame: int) -> GaussianField:
    """The field of a frame, given or fitted.

    Raises:
        JobError: it is not there.
    """
    gaussians, output = session.job.shot.gaussians, session.output.root
    assert gaussians is not None
    if gaussians.path is not None:
        return read_field(frame_path(session.job.root, gaussians.path, frame))
    path = frame_path(output, FIELD, frame)
    if session.book.find(FIT, frame) is None or not path.is_file():
        raise JobError(
            f"The Gaussian field of frame {frame} is not fitted yet", str(path), "a field",
            "`yesnt gof fit SHOT` fits it",
        )  # fmt: skip
    return read_field(path)


def _path(session: Session, field: GaussianField, frame: int, stops: Sequence[str], views: int) -> Camera:
    from yesnt.gaussians.orbit import between, bounds, orbit

    job, (centre, _) = session.job, bounds(field)
    if not stops:
        return orbit(shot_camera(job), frame, centre, views)
    capture = job.shot.capture
    known = cameras_of(job.root, capture) if capture else {}
    unknown = [name for name in stops if name not in known]
    if unknown:
        raise UsageError(
            f"The capture has no camera {unknown[0]!r}", "--path",
            f"`orbit`, or some of {', '.join(known) or '(none)'}",
            "check its spelling, and that the job names the capture",
        )  # fmt: skip
    return between([(known[name].camera, known[name].pose_of(frame)) for name in stops], centre, views)
