"""Reads the calibrated cameras of a capture: `cameras.json`, or another program's calibration (docs/capture.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.camera_axes import UNITS
from yesnt.core.camera_document import COMMENT_KEYS, REQUIRED_KEYS, refuse_unknown_keys
from yesnt.core.capture_input import CaptureCameras
from yesnt.core.errors import JobError
from yesnt.io.calibrations.registry import calibration_files, calibration_of
from yesnt.io.jobfile import frame_path

_EXPECTED = '{"axes", "units", "cameras": {"c00": {width, height, fx, ..., "world_from_camera": [16 numbers]}}}'
_STILL = 0
"""Frame number under which a camera at rest keeps its only pose."""


UP: Mapping[str, NDArray[np.float64]] = MappingProxyType({
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
})  # fmt: skip
"""Rotations that turn the axis that points up in a calibration's world to Z."""


@dataclass(frozen=True)
class World:
    """What the job says of a calibration's world.

    Attributes:
        up: its axis that points up, a key of `UP`.
        units: "m", "cm", "mm", or metres of one unit; None: as the file or its format says.
    """

    up: str = "z"
    units: str | float | None = None


FILE_WORLD = World()
"""The file's own unit, Z up."""


def metres_of(units: str | float) -> float:
    """Metres of one unit."""
    return UNITS[units] if isinstance(units, str) else units


@dataclass(frozen=True)
class CalibratedCamera:
    """One camera of a capture.

    Attributes:
        camera: the camera, in OpenCV axes and metres.
        gain: linear factors of red, green, blue that bring its pictures to those of the other cameras.
        still: whether it has one pose for all frames.
    """

    camera: Camera
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    still: bool = True

    def pose_of(self, frame: int) -> int | None:
        """What `Camera.pose`, `rays` and `project` take for a frame: None of a camera at rest."""
        return None if self.still else frame


def read_cameras(path: Path, world: World = FILE_WORLD) -> dict[str, CalibratedCamera]:
    """The cameras of a calibration by name, in the file's order, in metres of a Z-up world.

    Args:
        path: a file or folder of a kind that `io/calibrations/registry.py` lists.
        world: what the job says of the calibration's world.

    Raises:
        JobError: the file is missing, is of no kind that is understood, or a key is unknown, absent or wrong; names
            the camera.
    """
    data = calibration_of(path).read(path)
    cameras = data.get("cameras")
    if not isinstance(cameras, dict) or not cameras:
        raise JobError("The file names no cameras", str(path), _EXPECTED, "export it again")
    refuse_unknown_keys(data, ("axes", "units", "cameras", *COMMENT_KEYS), str(path))
    common: dict[str, Any] = {key: data[key] for key in ("axes", "units") if key in data}
    found = {name: _camera(entry, common, f"{path}: camera {name}") for name, entry in cameras.items()}
    if world == FILE_WORLD:
        return found
    assumed = UNITS[common.get("units", "m")]
    scale = 1.0 if world.units is None else metres_of(world.units) / assumed
    return {name: _in_world(one, world.up, scale) for name, one in found.items()}


def calibration_path(root: str, capture: CaptureCameras) -> Path:
    """The file or folder of a job's calibration."""
    return frame_path(root, capture.cameras, 0)


def cameras_of(root: str, capture: CaptureCameras) -> dict[str, CalibratedCamera]:
    """The cameras of a job's capture by name.

    Raises:
        JobError: as `read_cameras`.
    """
    return read_cameras(calibration_path(root, capture), World(capture.up, capture.units))


def calibration_roles(root: str, capture: CaptureCameras) -> dict[str, Path]:
    """The files of a job's calibration by role: `cameras`, then `cameras 1` and so on.

    Raises:
        JobError: there is no calibration.
    """
    files = calibration_files(calibration_path(root, capture))
    return {f"cameras {number}" if number else "cameras": file for number, file in enumerate(files)}


def _in_world(one: CalibratedCamera, up: str, scale: float) -> CalibratedCamera:
    turn = np.eye(4)
    turn[:3, :3] = UP[up]
    poses: dict[int, NDArray[np.float64]] = {}
    for frame, pose in one.camera.poses.items():
        moved = turn @ pose
        moved[:3, 3] *= scale
        moved.setflags(write=False)
        poses[frame] = moved
    return replace(one, camera=replace(one.camera, poses=poses))


def _camera(entry: Any, common: dict[str, Any], where: str) -> CalibratedCamera:
    if not isinstance(entry, dict) or ("frames" in entry) == ("world_from_camera" in entry):
        raise JobError(
            "The camera has not one of `world_from_camera` and `frames`", where,
            f"`world_from_camera` of a camera at rest, or `frames`, and {', '.join(REQUIRED_KEYS[:-1])}", "mend it",
        )  # fmt: skip
    own = common | {key: value for key, value in entry.items() if key not in ("gain", "world_from_camera")}
    still = "world_from_camera" in entry
    if still:
        own["frames"] = {str(_STILL): {"world_from_camera": entry["world_from_camera"]}}
    return CalibratedCamera(Camera.from_dict(own, where), _gain(entry.get("gain", [1, 1, 1]), where), still)


def _gain(values: Any, where: str) -> tuple[float, float, float]:
    numbers = isinstance(values, list) and all(isinstance(v, int | float) and 0 < v < float("inf") for v in values)
    if not numbers or len(values) != 3:
        raise JobError("The camera's gain cannot be used", f"{where}: gain", "three positive numbers", "correct it")
    red, green, blue = (float(v) for v in values)
    return red, green, blue
