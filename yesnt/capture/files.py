"""The files of the capture's cameras: pictures in three layouts, videos, mattes beside them, and their calibration.

`capture/{camera}/plate.####.exr` is a folder per camera, `frames/####/{camera}.png` a folder per frame, and
`videos/{camera}.mp4` a video per camera.
"""

from __future__ import annotations

import re
from pathlib import Path

from yesnt.core.capture_input import CAMERA, CaptureCameras
from yesnt.io.jobfile import frame_path
from yesnt.io.video import is_video

VIEW, MATTE = "view", "view matte"
"""Roles of a camera's files."""

_FRAME_FOLDER = re.compile(r"#+|%0?\d*d|\$F\d*")  # in folders `@` may be part of a name


def camera_files(root: str, capture: CaptureCameras, name: str, frame: int) -> dict[str, Path]:
    """A camera's files of one frame by role; a video is the same file for all frames.

    Args:
        root: folder of the job file.
        capture: section of the job.
        name: of the camera.
        frame: frame number of the shot; files of a camera that is late have later numbers.
    """
    patterns = {VIEW: capture.images, MATTE: capture.mattes}
    number = file_number(capture, name, frame)
    return {role: pattern_file(root, p.replace(CAMERA, name), number) for role, p in patterns.items() if p is not None}


def file_number(capture: CaptureCameras, name: str, frame: int) -> int:
    """The number under which a camera's files hold a frame of the shot."""
    return frame + capture.offsets.get(name, 0)


def pattern_file(root: str, pattern: str, number: int) -> Path:
    """The file of a pattern whose folders may hold the number too."""
    folder, slash, base = pattern.rpartition("/")
    if is_video(Path(base)):
        return Path(frame_path(root, folder or ".", 0), base) if folder else frame_path(root, base, 0)
    placed = _FRAME_FOLDER.sub(lambda sign: _numbered(sign[0], number), folder)
    return frame_path(root, f"{placed}{slash}{base}", number)


def _numbered(sign: str, number: int) -> str:
    """A number as a sign of a pattern pads it: `####` and `%04d` are four digits."""
    digits = len(sign) if sign.startswith("#") else int("".join(c for c in sign if c.isdigit()) or 1)
    return f"{number:0{digits}d}"
