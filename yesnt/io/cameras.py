"""Reads `cameras.json`: the calibrated cameras of a capture (docs/roadmap.md)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.camera import Camera
from yesnt.core.camera_document import COMMENT_KEYS, REQUIRED_KEYS, refuse_unknown_keys
from yesnt.core.errors import JobError

_EXPECTED = '{"axes", "units", "cameras": {"c00": {width, height, fx, ..., "world_from_camera": [16 numbers]}}}'
_STILL = 0
"""Frame number under which a camera at rest keeps its only pose."""


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


def read_cameras(path: Path) -> dict[str, CalibratedCamera]:
    """The cameras of a `cameras.json` by name, in the file's order.

    Raises:
        JobError: the file is missing, is not JSON, or a key is unknown, absent or wrong; names the camera.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise JobError("The file of the cameras is missing", str(path), "a cameras.json", "write it") from error
    except (ValueError, OSError) as error:
        raise JobError(
            f"The file of the cameras cannot be read ({error})", str(path), "JSON text", "export it again"
        ) from error
    cameras = data.get("cameras") if isinstance(data, dict) else None
    if not isinstance(cameras, dict) or not cameras:
        raise JobError("The file names no cameras", str(path), _EXPECTED, "export it again")
    refuse_unknown_keys(data, ("axes", "units", "cameras", *COMMENT_KEYS), str(path))
    common = {key: data[key] for key in ("axes", "units") if key in data}
    return {name: _camera(entry, common, f"{path}: camera {name}") for name, entry in cameras.items()}


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
