"""`transforms.json` of nerfstudio and instant-ngp (https://docs.nerf.studio/quickstart/data_conventions.html).

`transform_matrix` takes the camera, which looks along -z with +y up, to a world with Z up. Poses already contain
`applied_transform` and `applied_scale`: both say how the world of the calibration became this one, so that nothing is
left to do with them. They are checked, and kept as the document's comment.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from yesnt.core.errors import JobError
from yesnt.io.calibrations.document import Document, by_camera

_MODELS = {
    "OPENCV": "brown", "PINHOLE": "none", "SIMPLE_PINHOLE": "none", "SIMPLE_RADIAL": "brown", "RADIAL": "brown",
    "FULL_OPENCV": "brown", "OPENCV_FISHEYE": "fisheye",
}  # fmt: skip
_BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE = ("k1", "k2", "k3", "k4")
_SIZES = {"w": "width", "h": "height", "cx": "cx", "cy": "cy"}


def is_transforms(data: Any) -> bool:
    """Whether parsed JSON is a `transforms.json`."""
    frames = data.get("frames") if isinstance(data, dict) else None
    return isinstance(frames, list) and any(isinstance(f, dict) and "transform_matrix" in f for f in frames)


def read_transforms(path: Path) -> Document:
    """A `transforms.json` as the document of `cameras.json`, named by the files of its pictures.

    Raises:
        JobError: a frame lacks its file, its size or its focal length, or has a camera model without a counterpart.
    """
    data = json.loads(path.read_text(encoding="utf-8"))
    _check_applied(data, str(path))
    entries = []
    for number, frame in enumerate(data["frames"]):
        where = f"{path}: frames[{number}]"
        if (
            not isinstance(frame, dict)
            or "transform_matrix" not in frame
            or not isinstance(frame.get("file_path"), str)
        ):
            raise JobError("The frame has no picture or no pose", where, "file_path and transform_matrix", "mend it")
        lens = _lens({key: value for key, value in data.items() if key != "frames"} | frame, where)
        pose = np.asarray(frame["transform_matrix"], dtype=np.float64)
        if pose.shape == (3, 4):
            pose = np.concatenate([pose, [[0, 0, 0, 1]]])
        entries.append((frame["file_path"], lens | {"world_from_camera": pose.ravel().tolist()}))
    return {"axes": "opengl", "cameras": by_camera(entries, str(path))}


def _lens(said: dict[str, Any], where: str) -> Document:
    """Size, intrinsics and distortion of a frame, its own before the file's."""
    model = str(said.get("camera_model", "OPENCV_FISHEYE" if said.get("is_fisheye") else "OPENCV"))
    if model not in _MODELS:
        raise JobError(
            f"The camera model {model} cannot be used", where, f"one of {', '.join(_MODELS)}",
            "undistort the pictures and export again",
        )  # fmt: skip
    absent = [key for key in ("w", "h") if key not in said]
    if absent or not ("fl_x" in said or "camera_angle_x" in said):
        absent += [] if "fl_x" in said or "camera_angle_x" in said else ["fl_x"]
        raise JobError(
            f"The frame lacks {', '.join(absent)}", where, "w, h and fl_x in pixels, for all frames or in each",
            "add them; a file of synthetic NeRF scenes has a camera_angle_x and no size",
        )  # fmt: skip
    width, height = int(said["w"]), int(said["h"])
    fx = float(said["fl_x"]) if "fl_x" in said else 0.5 * width / math.tan(0.5 * float(said["camera_angle_x"]))
    entry: Document = {
        "width": width, "height": height, "fx": fx, "fy": float(said.get("fl_y", fx)),
        "cx": float(said.get("cx", width / 2)), "cy": float(said.get("cy", height / 2)),
    }  # fmt: skip
    kind = _MODELS[model]
    if kind != "none":
        k = [float(said.get(key, 0)) for key in (_FISHEYE if kind == "fisheye" else _BROWN)]
        entry["distortion"] = {"model": kind, "k": k}
    return entry


def _check_applied(data: dict[str, Any], where: str) -> None:
    """Refuses an `applied_transform` that is no rotation: poses would then have been written in another way."""
    applied = data.get("applied_transform")
    if applied is None:
        return
    matrix = np.asarray(applied, dtype=np.float64)
    turn = matrix[:3, :3] if matrix.shape in ((3, 4), (4, 4)) else np.zeros((3, 3))
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
        raise JobError(
            "`applied_transform` is no rotation and translation", f"{where}: applied_transform",
            "3 rows of 4 numbers, without scale (`applied_scale` holds that) or mirroring", "export it again",
        )  # fmt: skip
