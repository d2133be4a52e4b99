"""Reads the picture and the matte of one camera of the capture: undistorted, straight, in the working space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.files import MATTE, VIEW, camera_files, file_number
from yesnt.capture.hull import Silhouette
from yesnt.capture.undistort import resampling, undistorted_camera
from yesnt.core.camera import Camera
from yesnt.core.camera_document import Lens
from yesnt.core.capture_input import CaptureCameras
from yesnt.core.color import straighten
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, PlateInput
from yesnt.decompose.evidence.records import View
from yesnt.io.cameras import CalibratedCamera
from yesnt.io.color_statements import Statement
from yesnt.io.job_colors import check_statement
from yesnt.io.pictures.association import PREMULTIPLIED, association
from yesnt.io.pictures.channels import Channel
from yesnt.io.pictures.decode_color import to_scene_linear
from yesnt.io.pictures.image import ImageHeader, read_headers
from yesnt.io.pictures.passes import ColorChannels, find_color, find_matte
from yesnt.io.pictures.placed import read_placed
from yesnt.io.video import is_video, read_picture, video_index

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class Picture:
    """What a camera saw in a frame.

    Attributes:
        name: of the camera.
        camera: without distortion, for this frame.
        pose: what `Camera.pose` takes: the frame, or None of a camera at rest.
        radiance: [H, W, 3] straight scene-linear colour in the working space; NaN where a pixel is damaged.
        matte: [H, W] coverage in [0, 1]; None where no file holds it.
    """

    name: str
    camera: Camera
    pose: int | None
    radiance: F32
    matte: F32 | None


def read_view(job: Job, name: str, calibrated: CalibratedCamera, frame: int) -> View:
    """What a camera of the capture saw in a frame, with its matte.

    Raises:
        JobError: the picture cannot be read, is of another size than its camera, or has no matte.
    """
    found = read_camera_picture(job, name, calibrated, frame)
    if found.matte is None:
        raise _no_matte(name, str(camera_files(job.root, _capture(job), name, frame)[VIEW]))
    return View(name, found.camera, found.pose, found.radiance, found.matte)


def read_silhouette(job: Job, name: str, calibrated: CalibratedCamera, frame: int) -> Silhouette:
    """The subject as a camera of the capture sees it in a frame; without its picture, if the matte has a file.

    Raises:
        JobError: as `read_view`.
    """
    capture = _capture(job)
    files = camera_files(job.root, capture, name, frame)
    if MATTE not in files:
        view = read_view(job, name, calibrated, frame)
        return Silhouette(name, view.camera, view.pose, view.matte)
    path = files[MATTE]
    index = video_index(path) if is_video(path) else find_matte(read_headers(path), None, "capture.mattes")[0].header
    camera = _fitted(name, calibrated.camera, (index.width, index.height), capture, str(path))
    matte, pose = _separate_matte(job, name, camera, files, frame), calibrated.pose_of(frame)
    assert matte is not None, "its file is named"
    if (taken := resampling(camera, pose, f"camera {name}")) is not None:
        matte, camera = taken.apply(matte), undistorted_camera(camera, pose, taken)
    return Silhouette(name, camera, pose, matte)


def read_camera_picture(job: Job, name: str, calibrated: CalibratedCamera, frame: int) -> Picture:
    """What a camera of the capture saw in a frame.

    Raises:
        JobError: the picture cannot be read, or is of another size than its camera.
    """
    capture = _capture(job)
    files = camera_files(job.root, capture, name, frame)
    stored = _stored(job, name, calibrated.camera, files, frame)
    color, alpha, matte, camera = stored.color, stored.alpha, stored.matte, stored.camera
    pose = calibrated.pose_of(frame)
    if (taken := resampling(camera, pose, f"camera {name}")) is not None:
        color, camera = taken.apply(color), undistorted_camera(camera, pose, taken)
        alpha, matte = (None if part is None else taken.apply(part) for part in (alpha, matte))
    if alpha is not None:
        color = straighten(color, alpha)
    radiance = _linear(job, color) * np.array(calibrated.gain, np.float32)
    return Picture(name, camera, pose, radiance.astype(np.float32), matte)


def read_recorded(
    job: Job, name: str, calibrated: CalibratedCamera, path: Path, position: int | None
) -> tuple[F32, Camera]:
    """A picture of one camera as it was recorded, and the camera, whose lens still distorts.

    Args:
        job: the job.
        name: of the camera.
        calibrated: the camera.
        path: a picture, or a video.
        position: of the picture in the video; None of a picture.

    Returns:
        Radiance [H, W, 3], straight, scene-linear in the working space, NaN where a pixel is damaged; and the camera.

    Raises:
        JobError: the picture cannot be read, or is of another size than its camera.
    """
    if position is not None:
        return recorded_in_video(job, name, calibrated, path, read_picture(path, position))
    stored = _picture(job, name, calibrated.camera, path)
    color = stored.color if stored.alpha is None else straighten(stored.color, stored.alpha)
    return _linear(job, color) * np.array(calibrated.gain, np.float32), stored.camera


def recorded_in_video(job: Job, name: str, calibrated: CalibratedCamera, path: Path, color: F32) -> tuple[F32, Camera]:
    """The same of a picture [H, W, 3] that was decoded from a video."""
    camera = _fitted(name, calibrated.camera, (color.shape[1], color.shape[0]), _capture(job), str(path))
    return _linear(job, color) * np.array(calibrated.gain, np.float32), camera


def frame_source(job: Job, name: str, frame: int) -> tuple[Path, int | None]:
    """The file that shows a frame to a camera, and the position in it if it is a video."""
    capture = _capture(job)
    path = camera_files(job.root, capture, name, frame)[VIEW]
    return path, video_position(capture, name, frame) if is_video(path) else None


def _linear(job: Job, color: F32) -> F32:
    """Scene-linear radiance of stored straight colours; NaN where a pixel is damaged."""
    damaged = np.asarray(~np.isfinite(color).all(axis=-1))
    linear = to_scene_linear(np.where(damaged[..., None], 0, color).astype(np.float32), job.colors.capture)
    return np.where(damaged[..., None], np.nan, linear).astype(np.float32)


def check_picture(
    name: str, camera: Camera, headers: Sequence[ImageHeader], found: ColorChannels, capture: CaptureCameras
) -> None:
    """Refuses a picture of another size than its camera, and one without a matte.

    Raises:
        JobError: as said.
    """
    _fitted(name, camera, found.color[0].header.display.size, capture, headers[0].path)
    if found.alpha is None and capture.mattes is None:
        raise _no_matte(name, headers[0].path)


def check_files(
    job: Job, name: str, calibrated: CalibratedCamera, frame: int, first: Statement, mattes: bool = True
) -> None:
    """Looks at the headers of a camera's files of one frame, before any work.

    Args:
        job: the job.
        name: of the camera.
        calibrated: the camera.
        frame: frame number.
        first: what the first camera's pictures say of their colours.
        mattes: whether mattes are looked at; those that a run makes are not there before.

    Raises:
        JobError: as `read_view`, or the picture states another colour space than the others.
    """
    capture = _capture(job)
    files = camera_files(job.root, capture, name, frame)
    if not mattes:
        files.pop(MATTE, None)
    if is_video(files[VIEW]):
        _check_video(name, calibrated.camera, files[VIEW], capture, frame)
        if capture.mattes is None:
            raise _no_matte(name, str(files[VIEW]))
    else:
        headers = read_headers(files[VIEW])
        found = find_color(headers, PlateInput(path=str(files[VIEW])), "capture")
        check_picture(name, calibrated.camera, headers, found, capture)
        check_statement(files[VIEW], job.shot, "capture", first)
    if MATTE in files and is_video(files[MATTE]):
        _check_video(name, calibrated.camera, files[MATTE], capture, frame)
    elif MATTE in files:
        _matte_channels(name, calibrated.camera, files[MATTE], capture)


def check_plate(job: Job, name: str, calibrated: CalibratedCamera, path: Path, first: Statement) -> None:
    """Looks at the header of a camera's clean plate, a picture or a video.

    Raises:
        JobError: it is of another size than its camera, or states another colour space than the pictures.
    """
    capture = _capture(job)
    if is_video(path):
        index = video_index(path)
        _fitted(name, calibrated.camera, (index.width, index.height), capture, str(path))
        return
    found = find_color(read_headers(path), PlateInput(path=str(path)), "capture.matting")
    _fitted(name, calibrated.camera, found.color[0].header.display.size, capture, str(path))
    check_statement(path, job.shot, "capture", first)


def video_position(capture: CaptureCameras, name: str, frame: int) -> int:
    """Position of a frame in a camera's video; 0 is its first picture."""
    return file_number(capture, name, frame) - capture.first


@dataclass(frozen=True)
class _Stored:
    """A picture as its file holds it: colour [H, W, 3], the alpha that it was multiplied by, coverage, its camera."""

    color: F32
    alpha: F32 | None
    matte: F32 | None
    camera: Camera


def _stored(job: Job, name: str, camera: Camera, files: dict[str, Path], frame: int) -> _Stored:
    capture, path = _capture(job), files[VIEW]
    if is_video(path):
        color = read_picture(path, video_position(capture, name, frame))
        fitted = _fitted(name, camera, (color.shape[1], color.shape[0]), capture, str(path))
        return _Stored(color, None, _separate_matte(job, name, fitted, files, frame), fitted)
    found = _picture(job, name, camera, path)
    matte = _separate_matte(job, name, found.camera, files, frame)
    return found if matte is None else replace(found, matte=matte)


def _picture(job: Job, name: str, camera: Camera, path: Path) -> _Stored:
    """A picture in a file of its own."""
    headers, spec = read_headers(path), PlateInput(path=str(path))
    found = find_color(headers, spec, "capture")
    fitted = _fitted(name, camera, found.color[0].header.display.size, _capture(job), headers[0].path)
    *rgb, last = read_placed(_sized(job, fitted), [*found.color, found.alpha or found.color[0]])
    alpha = None if found.alpha is None else np.clip(np.nan_to_num(last), 0, 1).astype(np.float32)
    multiplied = alpha if alpha is not None and association(found, spec) == PREMULTIPLIED else None
    return _Stored(np.stack(rgb, axis=-1), multiplied, alpha, fitted)


def _capture(job: Job) -> CaptureCameras:
    assert job.shot.capture is not None
    return job.shot.capture


def _sized(job: Job, camera: Camera) -> Job:
    """The job as if its pictures had the size of a camera's."""
    return job.model_copy(update={"width": camera.width, "height": camera.height, "raster": None})


def _fitted(name: str, camera: Camera, size: tuple[int, int], capture: CaptureCameras, path: str) -> Camera:
    """The camera of pictures of a size: its own, or scaled and centred in them where the job says `resize: fit`.

    Raises:
        JobError: the sizes differ and the job does not say how.
    """
    if size == (camera.width, camera.height):
        return camera
    if capture.resize == "fit":
        return scaled_camera(camera, size)
    raise JobError(
        f"The picture of camera {name} is {size[0]}x{size[1]}", path,
        f"{camera.width}x{camera.height}, as the calibration says",
        "undistort and scale pictures and calibration together, correct the calibration's width and height, or set "
        "`resize: fit` if the whole picture was scaled into this frame and centred",
    )  # fmt: skip


def scaled_camera(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera of its picture scaled as a whole into a frame of a size (width, height) and centred there."""
    scale = min(size[0] / camera.width, size[1] / camera.height)
    left, top = (0.5 * (now - scale * was) for now, was in zip(size, (camera.width, camera.height), strict=True))

    def scaled(lens: Lens) -> Lens:
        cx, cy = scale * lens.cx + left, scale * lens.cy + top
        return Lens(scale * lens.fx, scale * lens.fy, cx, cy, lens.distortion)

    own = scaled(Lens(camera.fx, camera.fy, camera.cx, camera.cy))
    lenses = {frame: scaled(lens) for frame, lens in camera.lenses.items()}
    width, height = size
    return replace(
        camera, width=width, height=height, fx=own.fx, fy=own.fy, cx=own.cx, cy=own.cy, lenses=MappingProxyType(lenses)
    )


def _no_matte(name: str, path: str) -> JobError:
    return JobError(
        f"The pictures of camera {name} have no alpha, and `capture` names no mattes", path,
        'alpha, or `mattes: "capture/{camera}/matte.####.png"`', "add one of both",
    )  # fmt: skip


def _check_video(name: str, camera: Camera, path: Path, capture: CaptureCameras, frame: int) -> None:
    """Refuses a video of another size than its camera, or without the frame."""
    index, position = video_index(path), video_position(capture, name, frame)
    _fitted(name, camera, (index.width, index.height), capture, str(path))
    if not 0 <= position < len(index.stamps):
        first = capture.first - capture.offsets.get(name, 0)
        raise JobError(
            f"The video of camera {name} has no picture for frame {frame}", str(path),
            f"frames {first} to {first + len(index.stamps) - 1}, since `capture.first` is {capture.first}",
            "check `frames`, `capture.first` and `capture.offsets`",
        )  # fmt: skip


def _matte_channels(name: str, camera: Camera, path: Path, capture: CaptureCameras) -> tuple[Channel, ...]:
    channels = find_matte(read_headers(path), None, "capture.mattes")
    _fitted(name, camera, channels[0].header.display.size, capture, channels[0].header.path)
    return channels


def _separate_matte(job: Job, name: str, camera: Camera, files: dict[str, Path], frame: int) -> F32 | None:
    """Coverage [H, W] in [0, 1] from a file of its own; None if there is none. `camera` is that of the picture."""
    if MATTE not in files:
        return None
    capture, path = _capture(job), files[MATTE]
    if is_video(path):
        planes = list(np.moveaxis(read_picture(path, video_position(capture, name, frame)), -1, 0))
        same = all(np.abs(planes[0] - other).max() < _GREY for other in planes[1:])
        if planes[0].shape != (camera.height, camera.width):
            raise _other_size(name, planes[0].shape, camera, path)
    else:
        channels = find_matte(read_headers(path), None, "capture.mattes")
        if channels[0].header.display.size != (camera.width, camera.height):
            raise _other_size(name, channels[0].header.display.size[::-1], camera, path)
        planes = read_placed(_sized(job, camera), channels)
        same = all(np.array_equal(planes[0], other) for other in planes[1:])
    if not same:
        raise JobError(
            f"The matte of camera {name} has a red, green and blue that differ", str(path), "one grey channel",
            "export the matte as a grey picture",
        )  # fmt: skip
    return np.clip(np.nan_to_num(planes[0]), 0, 1).astype(np.float32)


_GREY = 0.04  # largest difference between the colours of a grey video: chroma is coded apart from luma


def _other_size(name: str, shape: tuple[int, ...], camera: Camera, path: Path) -> JobError:
    return JobError(
        f"The matte of camera {name} is {shape[1]}x{shape[0]}", str(path),
        f"{camera.width}x{camera.height}, as its picture is", "export pictures and mattes at one size",
    )  # fmt: skip
