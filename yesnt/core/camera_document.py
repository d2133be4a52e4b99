"""The parsed text of `camera.json`, and of one camera of `cameras.json`, checked and converted (docs/files.md)."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera_axes import AXES, UNITS, opencv_pose
from yesnt.core.distortion import UNDISTORTED, Distortion
from yesnt.core.errors import JobError

LENS_KEYS = ("fx", "fy", "cx", "cy")
SIZE_KEYS = ("width", "height")
REQUIRED_KEYS = (*SIZE_KEYS, *LENS_KEYS, "frames")
COMMENT_KEYS = ("name", "comment", "source")
"""Keys that say where a camera came from; nothing reads them."""

MAX_SIDE = 1 << 16


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a frame, pixels, and its distortion.

    Attributes:
        fx, fy: focal lengths.
        cx, cy: principal point from the upper left corner; pixel centres lie at +0.5.
        distortion: of the plane z = 1, before the intrinsics are applied.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = UNDISTORTED


@dataclass(frozen=True)
class CameraDocument:
    """What a camera's document says, in OpenCV axes and metres.

    Attributes:
        size: width and height, pixels.
        lenses: lens of every frame.
        poses: `world_from_camera` [4, 4] of every frame.
    """

    size: tuple[int, int]
    lenses: Mapping[int, Lens]
    poses: Mapping[int, NDArray[np.float64]]


def read_document(data: Any, where: str) -> CameraDocument:
    """Checks the parsed text of a camera.

    Args:
        data: the document (contract.md, `camera.json`).
        where: names it in errors.

    Raises:
        JobError: a key is unknown, absent or wrong.
    """
    required = REQUIRED_KEYS
    if not isinstance(data, dict):
        raise JobError("The camera is no JSON object", where, ", ".join(required), "export it again")
    refuse_unknown_keys(data, (*required, "axes", "units", "distortion", *COMMENT_KEYS), where)
    frames = data.get("frames")
    entries = frames if isinstance(frames, dict) and all(isinstance(e, dict) for e in frames.values()) else {}
    of_frames = [key for key in LENS_KEYS if entries and all(key in entry for entry in entries.values())]
    missing = [key for key in required if key not in data and key not in of_frames]
    if missing:
        raise JobError(f"The camera lacks {', '.join(missing)}", where, ", ".join(required), "add them")
    if not entries:
        raise JobError(
            "A camera pose cannot be read", f"{where}: frames", '{"1001": {"world_from_camera": [16 numbers]}}',
            "correct it",
        )  # fmt: skip
    axes, units = word(data, "axes", AXES, "opencv", where), word(data, "units", UNITS, "m", where)
    common = _lens(data, where) if not of_frames else None
    lenses, poses = {}, {}
    for name, entry in entries.items():
        place = f"{where}: frame {name}"
        refuse_unknown_keys(entry, ("world_from_camera", *LENS_KEYS, "distortion"), place)
        frame = _frame_number(name, place)
        poses[frame] = opencv_pose(entry.get("world_from_camera"), place, axes, units)
        lenses[frame] = common if common and len(entry) == 1 else _lens({**data, **entry}, place)
    return CameraDocument(_size(data, where), lenses, poses)


def word(data: Mapping[str, Any], key: str, known: Collection[str], default: str, where: str) -> str:
    """The value of a key that holds one of a few words.

    Raises:
        JobError: it holds another.
    """
    value = data.get(key, default)
    if not isinstance(value, str) or value not in known:
        raise JobError(f"Unknown {key} {value!r}", where, f"one of {', '.join(known)}", "correct it")
    return value


def _size(data: Mapping[str, Any], where: str) -> tuple[int, int]:
    width, height = (_number(data, key, where) for key in SIZE_KEYS)
    if not all(0 < side <= MAX_SIDE and side == int(side) for side in (width, height)):
        raise JobError(
            "The camera's intrinsics are not usable", f"{where}: width {width:g}, height {height:g}",
            "whole positive numbers of pixels", "mend them",
        )  # fmt: skip
    return int(width), int(height)


def _lens(data: Mapping[str, Any], where: str) -> Lens:
    fx, fy, cx, cy = (_number(data, key, where) for key in LENS_KEYS)
    if min(fx, fy) <= 0:
        raise JobError(
            "The camera's intrinsics are not usable", f"{where}: fx {fx:g}, fy {fy:g}",
            "positive focal lengths in pixels; the direction of an axis is said by `axes`", "mend them",
        )  # fmt: skip
    return Lens(fx, fy, cx, cy, _distortion(data.get("distortion"), where))


def _distortion(data: Any, where: str) -> Distortion:
    if data is None:
        return UNDISTORTED
    place, expected = f"{where}: distortion", '{"model": "none" | "brown" | "fisheye", "k": [OpenCV\'s order]}'
    if not isinstance(data, dict):
        raise JobError("The distortion cannot be read", place, expected, "correct it")
    refuse_unknown_keys(data, ("model", "k"), place)
    model, k = word(data, "model", ("none", "brown", "fisheye"), "none", place), data.get("k", [])
    if not isinstance(k, list) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in k):
        raise JobError("The distortion's `k` cannot be read", place, "a list of numbers", "correct it")
    if model == "brown" and len(k) == 14 and not any(k[12:]):
        k = k[:12]
    if model == "none" and not any(k):
        k = []
    if model == "brown" and len(k) == 14:
        raise JobError(
            "The distortion has a tilted sensor (OpenCV's tau_x, tau_y)", place, "at most 12 coefficients",
            "calibrate without CALIB_TILTED_MODEL",
        )  # fmt: skip
    try:
        return Distortion(model, tuple(float(v) for v in k))  # type: ignore[arg-type]
    except ValueError as error:
        raise JobError(f"The distortion cannot be used ({error})", place, expected, "correct it") from error


def _number(data: Mapping[str, Any], key: str, where: str) -> float:
    value = data[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise JobError(
            "The camera's intrinsics are not usable", f"{where}: {key} is {value!r}", "finite numbers", "mend them"
        )
    return float(value)


def _frame_number(name: str, where: str) -> int:
    try:
        return int(name)
    except ValueError as error:
        raise JobError(f"{name!r} is no frame number", where, "a whole number", "correct it") from error


def refuse_unknown_keys(data: Mapping[str, Any], known: Collection[str], where: str) -> None:
    """A misspelled key would silently leave its default in force.

    Raises:
        JobError: a key of `data` is not among the known ones; names the nearest.
    """
    for key in data:
        if key not in known:
            near = get_close_matches(str(key), known, 1)
            raise JobError(
                f"Unknown key {key!r} in the camera", where, f"one of {', '.join(dict.fromkeys(known))}",
                f"did you mean {near[0]!r}?" if near else "check its spelling or remove it",
            )  # fmt: skip
