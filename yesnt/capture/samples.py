"""Pictures that show a camera's background: its clean plate, or its own pictures spread over the recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.files import VIEW, camera_files, pattern_file
from yesnt.capture.pictures import read_recorded, recorded_in_video
from yesnt.core.camera import Camera
from yesnt.core.capture_input import CAMERA, CaptureCameras
from yesnt.core.shot import Job
from yesnt.io.cameras import CalibratedCamera
from yesnt.io.video import is_video, read_pictures, video_index

F32 = NDArray[np.float32]

MOST_SAMPLES = 25
"""Pictures of a background, evenly spaced."""

_SEEK = 240  # pictures between two samples from which seeking is faster than decoding all between


def background_files(job: Job, name: str) -> dict[str, Path]:
    """The files that show a camera's background by role; none where the job asks for no background."""
    capture = _matted(job)
    assert capture.matting is not None
    if not capture.matting.has_background:
        return {}
    if (pattern := capture.matting.clean_plates) is not None:
        return {f"clean {name}": pattern_file(job.root, pattern.replace(CAMERA, name), 0)}
    frames = [job.all_but()[i] for i in spread(len(job.all_but()), MOST_SAMPLES)]
    paths = [camera_files(job.root, capture, name, frame)[VIEW] for frame in frames]
    if is_video(paths[0]):
        return {f"background {name}": paths[0]}
    return {f"background {name} {frame}": path for frame, path in zip(frames, paths, strict=True)}


def spread(count: int, most: int) -> list[int]:
    """At most `most` of `count` positions, evenly spaced, the ends included."""
    return sorted({round(float(at)) for at in np.linspace(0, count - 1, min(count, most))})


def read_samples(job: Job, name: str, calibrated: CalibratedCamera) -> Iterator[tuple[F32, Camera]]:
    """Each picture of a camera's background as it was recorded, and its camera; one is held at a time.

    Raises:
        JobError: a picture cannot be read, or is of another size than its camera.
    """
    for path in background_files(job, name).values():
        if not is_video(path):
            yield read_recorded(job, name, calibrated, path, None)
            continue
        positions = spread(len(video_index(path).stamps), MOST_SAMPLES)
        step = max(np.diff(positions), default=0)
        groups = [[one] for one in positions] if step > _SEEK else [positions]
        for group in groups:
            for color in read_pictures(path, group):
                yield recorded_in_video(job, name, calibrated, path, color)


def _matted(job: Job) -> CaptureCameras:
    capture = job.shot.matted
    assert capture is not None, "only jobs that make mattes"
    return capture
