"""Says in words and numbers what a camera file means, so that a user can compare it with the program it came from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.camera_document import Lens
from yesnt.core.frame_ranges import frame_ranges
from yesnt.io.camera_files.files import document_of

F64 = NDArray[np.float64]

_OFF_CENTRE = 0.1  # of the picture, by which a principal point may lie beside its middle unnoticed
_SQUARE = 0.005  # by which fy / fx may differ from 1 unnoticed
_UPRIGHT = 0.3  # least part of world up in the picture's up, unless the camera looks up or down
_LEVEL = 0.9
_ANGLES = (3.0, 140.0)  # degrees of horizontal view outside which a unit is probably wrong


@dataclass(frozen=True)
class CameraFacts:
    """A camera in words.

    Attributes:
        rows: what, and its value.
        warnings: what is unusual, with numbers.
        document: the camera as `camera.json`.
    """

    rows: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    document: dict[str, Any]


def describe(camera: Camera, source: str) -> CameraFacts:
    """Describes a camera.

    Raises:
        JobError: its lens shows nothing at some pixel of some frame.
    """
    frames = sorted(camera.poses)
    camera.check(frames)
    lenses = {frame: camera.lens(frame) for frame in frames}
    rows = [("pictures", f"{camera.width}x{camera.height}"), ("frames", f"{frame_ranges(frames)} ({len(frames)})")]
    rows += _lens_rows(camera, lenses[frames[0]])
    changing = sum(lens != lenses[frames[0]] for lens in lenses.values())
    if changing:
        rows.append(("zoom", f"{changing} frames have another lens; last focal length {lenses[frames[-1]].fx:.6g} px"))
    for name, frame in dict.fromkeys((("first", frames[0]), ("last", frames[-1]))):
        rows.append((f"{name} frame", _place(camera.pose(frame))))
    warnings = list(_warnings(camera, frames))
    if source.lower().endswith(".abc") and len(frames) > 1:
        warnings.append("Alembic is read by Blender, which takes the lens of the first frame: a zoom is not imported")
    return CameraFacts(tuple(rows), tuple(warnings), document_of(camera, source))


def _lens_rows(camera: Camera, lens: Lens) -> Iterable[tuple[str, str]]:
    yield "focal length", f"{lens.fx:.6g} px across, {lens.fy:.6g} px down"
    yield (
        "field of view",
        f"{_angle(lens.fx, camera.width):.4g} degrees across, {_angle(lens.fy, camera.height):.4g} down",
    )
    yield "principal point", f"{lens.cx:.6g}, {lens.cy:.6g} (the middle is {camera.width / 2:g}, {camera.height / 2:g})"
    if not lens.distortion.acts:
        yield "distortion", "none"
        return
    x, y = ((np.array([0, camera.width, 0, camera.width]) - lens.cx) / lens.fx,
            (np.array([0, 0, camera.height, camera.height]) - lens.cy) / lens.fy)  # fmt: skip
    straight_x, straight_y = lens.distortion.undistort(x, y)
    moved = np.hypot((straight_x - x) * lens.fx, (straight_y - y) * lens.fy).max()
    yield "distortion", f"{lens.distortion.model} {list(lens.distortion.k)}, {moved:.3g} px in the corners"


def _angle(focal: float, size: int) -> float:
    return float(np.degrees(2 * np.arctan(size / 2 / focal)))


def _place(pose: F64) -> str:
    """Where a camera is and looks, in the world."""
    return (
        f"at {_vector(pose[:3, 3])} m, looks along {_vector(pose[:3, 2])}, its picture's up is {_vector(-pose[:3, 1])}"
    )


def _vector(values: F64) -> str:
    return f"({', '.join(f'{value + 0.0:.3f}' for value in np.round(values, 3) + 0.0)})"


def _warnings(camera: Camera, frames: list[int]) -> Iterable[str]:
    lens = camera.lens(frames[0])
    if abs(lens.fy / lens.fx - 1) > _SQUARE:
        yield f"fy is {lens.fy / lens.fx:.4g} times fx: right only for pictures of that pixel aspect ratio"
    yield from oddities(camera, frames)


def oddities(camera: Camera, frames: Sequence[int]) -> Iterable[str]:
    """What is unusual of a camera, whatever its pictures are."""
    lens = camera.lens(frames[0])
    off = max(abs(lens.cx / camera.width - 0.5), abs(lens.cy / camera.height - 0.5))
    if off > _OFF_CENTRE:
        yield f"the principal point lies {off:.0%} of the picture beside its middle; cx, cy count from the upper left"
    angle = _angle(lens.fx, camera.width)
    if not _ANGLES[0] < angle < _ANGLES[1]:
        yield f"the field of view is {angle:.3g} degrees: fx must be in pixels"
    tilted = [frame for frame in frames if _fallen(camera.pose(frame))]
    if tilted:
        yield (
            f"the picture's up is not the world's at {len(tilted) / len(frames):.0%} of the frames, first "
            f'{tilted[0]}: a Y-up world, or other axes ("axes": "opengl" looks along -z)'
        )


def _fallen(pose: F64) -> bool:
    """Whether a camera that looks about level is not upright."""
    return bool(abs(pose[2, 2]) < _LEVEL and -pose[2, 1] < _UPRIGHT)
