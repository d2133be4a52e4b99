"""The pixels of a shot: one raster for all frames, from the headers of its plates and the camera's size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.core.windows import Raster, Window, union
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.image import MAX_SIDE
from yesnt.io.pictures.plate_header import PlateHeader

ASPECT_TOLERANCE = 1e-3
"""Relative difference of pixel aspect ratios that headers round to."""


def shot_raster(plates: Mapping[Path, PlateHeader], size: tuple[int, int]) -> Raster | None:
    """The raster of a shot.

    Args:
        plates: header of every plate, by path.
        size: columns and rows of the camera.

    Returns:
        None where every plate has the camera's size and nothing else to say, or another size that the checks refuse.

    Raises:
        JobError: plates differ in what a sequence has one of, or their data window is absurd.
    """
    first = next(iter(plates.values()))
    for path, plate in plates.items():
        _refuse_other(path, plate, first)
    camera = _camera_window(plates, size)
    if camera is None:
        return None
    processed = union([first.display, *(plate.data for plate in plates.values())])
    if max(processed.size) > MAX_SIDE:
        raise JobError(
            f"The plates' data windows cover {processed}", str(next(iter(plates))), f"at most {MAX_SIDE} on a side",
            "crop the data windows to the picture and its overscan",
        )  # fmt: skip
    metadata = tuple(dict.fromkeys(name for plate in plates.values() for name in plate.metadata))
    readings = tuple(sorted({plate.reading for plate in plates.values() if plate.reading}))
    raster = Raster(first.display, processed, camera, first.aspect, first.rate, metadata, readings)
    plain = Window(0, 0, *size)
    return None if raster == Raster(plain, plain, plain) else raster


def _camera_window(plates: Mapping[Path, PlateHeader], size: tuple[int, int]) -> Window | None:
    """What a camera of this size describes: the display window, or the data window that all plates have."""
    first = next(iter(plates.values()))
    if first.display.size == size:
        return first.display
    overscan = first.data.size == size and all(plate.data == first.data for plate in plates.values())
    return first.data if overscan else None


def _refuse_other(path: Path, plate: PlateHeader, first: PlateHeader) -> None:
    """Refuses a plate that does not fit the first.

    Raises:
        JobError: as said.
    """
    same = abs(plate.aspect - first.aspect) <= ASPECT_TOLERANCE * first.aspect
    for what, found, wanted in (
        ("display window", plate.display, first.display),
        ("pixel aspect ratio", plate.aspect, plate.aspect if same else first.aspect),
        ("frame rate", plate.rate, first.rate),
    ):
        if found != wanted:
            raise JobError(
                f"The plate has another {what} than the first: {found}", str(path), str(wanted),
                "export the whole sequence in one way",
            )  # fmt: skip


def shot_camera(job: Job) -> Camera:
    """The camera of a job, for the pixels that are processed.

    Raises:
        JobError: the camera's file is missing or wrong.
    """
    return for_raster(Camera.open(frame_path(job.root, job.shot.camera, 0)), job)


def for_raster(camera: Camera, job: Job) -> Camera:
    """A camera as it is in its file, for the pixels that are processed."""
    raster = job.raster
    if raster is None or raster.processed == raster.camera:
        return camera
    window = raster.processed.moved(-raster.camera.left, -raster.camera.top)
    return camera.windowed(window.left, window.top, window.width, window.height)
