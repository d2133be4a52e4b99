"""Reads the picture and the matte of one camera of the capture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.capture_input import CAMERA, CaptureCameras
from yesnt.core.color import straighten
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, PlateInput
from yesnt.decompose.evidence.records import View
from yesnt.io.cameras import CalibratedCamera
from yesnt.io.color_statements import Statement
from yesnt.io.job_colors import check_statement
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.association import PREMULTIPLIED, association
from yesnt.io.pictures.channels import Channel
from yesnt.io.pictures.decode_color import to_scene_linear
from yesnt.io.pictures.image import ImageHeader, read_headers
from yesnt.io.pictures.passes import ColorChannels, find_color, find_matte
from yesnt.io.pictures.placed import read_placed

F32 = NDArray[np.float32]


def picture_patterns(capture: CaptureCameras, name: str) -> dict[str, str]:
    """Patterns of a camera's files by role: `view`, and `view matte` if mattes have files of their own."""
    patterns = {"view": capture.images, "view matte": capture.mattes}
    return {role: pattern.replace(CAMERA, name) for role, pattern in patterns.items() if pattern is not None}


def read_view(job: Job, name: str, calibrated: CalibratedCamera, frame: int) -> View:
    """What a camera of the capture saw in a frame, in the working space; NaN where a pixel is damaged.

    Raises:
        JobError: the picture cannot be read, is of another size than its camera, or has no matte.
    """
    capture, camera = _capture(job), calibrated.camera
    files = {role: frame_path(job.root, pattern, frame) for role, pattern in picture_patterns(capture, name).items()}
    sized, spec = _sized(job, camera), PlateInput(path=str(files["view"]))
    headers = read_headers(files["view"])
    found = find_color(headers, spec, "capture")
    check_picture(name, camera, headers, found, capture)
    *rgb, alpha = read_placed(sized, [*found.color, found.alpha or found.color[0]])
    color = np.stack(rgb, axis=-1)
    matte = alpha if "view matte" not in files else _separate_matte(sized, name, camera, files["view matte"])
    matte = np.clip(np.nan_to_num(matte), 0, 1).astype(np.float32)
    if found.alpha is not None and association(found, spec) == PREMULTIPLIED:
        color = straighten(color, np.clip(np.nan_to_num(alpha), 0, 1).astype(np.float32))
    damaged = np.asarray(~np.isfinite(color).all(axis=-1))
    linear = to_scene_linear(np.where(damaged[..., None], 0, color).astype(np.float32), job.colors.capture)
    radiance = linear * np.array(calibrated.gain, np.float32)
    radiance[damaged] = np.nan
    return View(name, camera, calibrated.pose_of(frame), radiance.astype(np.float32), matte)


def check_picture(
    name: str, camera: Camera, headers: Sequence[ImageHeader], found: ColorChannels, capture: CaptureCameras
) -> None:
    """Refuses a picture of another size than its camera, and one without a matte.

    Raises:
        JobError: as said.
    """
    _check_size(name, camera, found.color[0].header)
    if found.alpha is None and capture.mattes is None:
        raise JobError(
            f"The pictures of camera {name} have no alpha, and `capture` names no mattes", headers[0].path,
            'alpha, or `mattes: "capture/{camera}/matte.####.png"`', "add one of both",
        )  # fmt: skip


def check_files(job: Job, name: str, calibrated: CalibratedCamera, frame: int, first: Statement) -> None:
    """Looks at the headers of a camera's files of one frame, before any work.

    Args:
        job: the job.
        name: of the camera.
        calibrated: the camera.
        frame: frame number.
        first: what the first camera's pictures say of their colours.

    Raises:
        JobError: as `read_view`, or the picture states another colour space than the others.
    """
    capture = _capture(job)
    files = {role: frame_path(job.root, pattern, frame) for role, pattern in picture_patterns(capture, name).items()}
    headers = read_headers(files["view"])
    found = find_color(headers, PlateInput(path=str(files["view"])), "capture")
    check_picture(name, calibrated.camera, headers, found, capture)
    check_statement(files["view"], job.shot, "capture", first)
    if "view matte" in files:
        _matte_channels(name, calibrated.camera, files["view matte"])


def _capture(job: Job) -> CaptureCameras:
    assert job.shot.captured is not None
    return job.shot.captured


def _sized(job: Job, camera: Camera) -> Job:
    """The job as if its pictures had the size of a camera's."""
    return job.model_copy(update={"width": camera.width, "height": camera.height, "raster": None})


def _check_size(name: str, camera: Camera, header: ImageHeader) -> None:
    if header.display.size != (camera.width, camera.height):
        raise JobError(
            f"The picture of camera {name} is {header.display.width}x{header.display.height}", header.path,
            f"{camera.width}x{camera.height}, as the calibration says",
            "undistort and scale pictures and calibration together, or correct the calibration's width and height",
        )  # fmt: skip


def _matte_channels(name: str, camera: Camera, path: Path) -> tuple[Channel, ...]:
    channels = find_matte(read_headers(path), None, "capture.mattes")
    _check_size(name, camera, channels[0].header)
    return channels


def _separate_matte(sized: Job, name: str, camera: Camera, path: Path) -> F32:
    """Coverage [H, W] from a file of its own."""
    first, *others = read_placed(sized, _matte_channels(name, camera, path))
    if any(not np.array_equal(first, other) for other in others):
        raise JobError(
            f"The matte of camera {name} has a red, green and blue that differ", str(path), "one grey channel",
            "export the matte as a grey picture",
        )  # fmt: skip
    return first
