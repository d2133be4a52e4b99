"""Nuke's `.chan`: a line a frame with place, angles in degrees and, of cameras, the vertical field of view.

Columns: frame, x, y, z, rx, ry, rz and the field of view in degrees, which may be absent. The camera looks along -z
with +y up. The file does not name the order of rotation (Nuke's default is ZXY), nor the sensor: a focal length in
pixels comes from the field of view and the height of the picture, or from a focal length and an aperture in mm.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from yesnt.core.errors import JobError, UsageError
from yesnt.io.camera_files.options import ImportOptions, euler, z_up

_EXPECTED = "lines of frame, x, y, z, rx, ry, rz and, of a camera, the vertical field of view"


def read_chan(path: Path, options: ImportOptions) -> dict[str, Any]:
    """A `.chan` file as the document of `camera.json`.

    Raises:
        JobError: the file cannot be read, a line is not as expected, or a wanted frame is absent.
        UsageError: the field of view or the size of the pictures is unknown.
    """
    rows = _rows(path)
    absent = [frame for frame in options.frames or () if frame not in rows]
    if absent:
        raise JobError(
            f"The file has no frame {absent[0]}", str(path), f"frames {min(rows)} to {max(rows)}", "check it"
        )
    lenses = {frame: _lens(rows[frame], options, path) for frame in options.frames or rows}
    (width, height), first = options.pixels, next(iter(lenses.values()))
    frames = {}
    for frame, lens in lenses.items():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = euler(rows[frame][3:6], options.rotation_order), rows[frame][:3]
        own = {} if lens == first else dict(zip(("fx", "fy"), lens, strict=True))
        frames[str(frame)] = {"world_from_camera": z_up(pose, options.up).ravel().tolist(), **own}
    size = {"width": width, "height": height, "cx": width / 2, "cy": height / 2}
    return {"axes": "opengl", "source": path.name, **size, "fx": first[0], "fy": first[1], "frames": frames}


def _rows(path: Path) -> dict[int, np.ndarray[Any, np.dtype[np.float64]]]:
    """Columns after the frame number, by frame."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise JobError(f"The camera file cannot be read ({error})", str(path), "a .chan file", "check it") from error
    rows = {}
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.zeros(0)
        if len(values) not in (7, 8) or not np.isfinite(values).all() or values[0] != int(values[0]):
            raise JobError("The line is no frame of a camera", f"{path}, line {number}", _EXPECTED, "export it again")
        rows[int(values[0])] = values[1:]
    if not rows:
        raise JobError("The file has no frames", str(path), _EXPECTED, "export it again")
    return rows


def _lens(row: np.ndarray[Any, np.dtype[np.float64]], options: ImportOptions, path: Path) -> tuple[float, float]:
    """Focal lengths in pixels, fx and fy."""
    width, height = options.pixels
    across, down = options.aperture or (None, None)
    if across is not None and down is None and options.focal is None:
        raise UsageError(
            "A width of the sensor alone does not give the focal length", "yesnt camera, --aperture",
            "`--aperture 24.576x18.672`, whose height belongs to the field of view of the file, or `--focal` too",
            "name the other",
        )  # fmt: skip
    if options.focal is not None and across is not None:
        fx = options.focal / across * width
        return fx, (options.focal / down * height if down else fx * options.pixel_aspect)
    if len(row) < 7 or not 0 < row[6] < 180:
        raise UsageError(
            "The file has no field of view", str(path), "an eighth column between 0 and 180 degrees",
            "name `--focal` and `--aperture` in millimetres, or export a camera and not an axis",
        )  # fmt: skip
    tangent = float(np.tan(np.radians(row[6]) / 2))
    fy = height / 2 / tangent
    # Nuke fits the horizontal aperture to the width: with another shape of the sensor fy is not that of the angle.
    fx = down / across / 2 / tangent * width if across and down else fy / options.pixel_aspect
    return fx, (fx * options.pixel_aspect if across and down else fy)
