"""Calibrations in OpenCV's FileStorage (.yml, .yaml, .xml): one file a camera, or one or two files for all.

One file a camera, in a folder, named by its file: `camera_matrix`, `distortion_coefficients`, `image_width`,
`image_height` as OpenCV's calibration sample writes them, and `R` (or `rvec`) and `T` (or `tvec`) of the camera.
One file for all, or `intri.yml` and `extri.yml`: `names`, and of each camera `K_NAME`, `dist_NAME`, `W_NAME`,
`H_NAME`, `Rot_NAME` (or the vector `R_NAME`) and `T_NAME`, as EasyMocap writes them.
Rotation and translation take the world to the camera. The centre of the first pixel is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.io.calibrations.document import OPENCV_CENTRES, Document, inverted

SUFFIXES = (".yml", ".yaml", ".xml")
PAIR = ("intri.yml", "extri.yml")

F64 = NDArray[np.float64]
Find = Callable[[str], Any]

_MATRIX = ("camera_matrix", "cameraMatrix", "K", "M")
_LENS = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "dist", "D")
_WIDTH, _HEIGHT = ("image_width", "width", "W"), ("image_height", "height", "H")
_TURN = ("Rot", "R", "rotation_matrix", "rvec", "rotation")
_PLACE = ("T", "tvec", "translation_vector", "translation")


def find_files(path: Path) -> tuple[Path, ...]:
    """The files of such a calibration at a path; none if there is none."""
    if path.is_file():
        return (path,) if path.suffix.lower() in SUFFIXES else ()
    pair = tuple(path / name for name in PAIR)
    if all(file.is_file() for file in pair):
        return pair
    return tuple(sorted(f for f in path.glob("*") if f.suffix.lower() in SUFFIXES)) if path.is_dir() else ()


def read_opencv(path: Path) -> Document:
    """Such a calibration as the document of `cameras.json`.

    Raises:
        JobError: a file cannot be read, or a camera lacks a part.
    """
    files = find_files(path)
    stored = [_stored(file) for file in files]
    merged = {key: value for one in stored for key, value in one.items()}
    names = merged.get("names", merged.get("camera_names"))
    if isinstance(names, list):
        cameras = {str(name): _entry(_named(merged, str(name)), f"{path}: camera {name}") for name in names}
    else:
        cameras = {file.stem: _entry(_plain(one), str(file)) for file, one in zip(files, stored, strict=True)}
    return {"axes": "opencv", "cameras": cameras}


def _named(merged: Mapping[str, Any], name: str) -> Find:
    return lambda key: merged.get(f"{key}_{name}")


def _plain(stored: Mapping[str, Any]) -> Find:
    return lambda key: stored.get(key)


def _entry(find: Find, where: str) -> Document:
    matrix = np.asarray(_first(find, _MATRIX, where), np.float64)
    if matrix.shape != (3, 3) or matrix[0, 1]:
        raise JobError("The camera matrix cannot be used", where, "3 x 3, without skew", "calibrate again")
    rotation = np.asarray(_first(find, _TURN, where), np.float64)
    translation = np.asarray(_first(find, _PLACE, where), np.float64).ravel()
    k = [float(v) for v in np.asarray(_first(find, _LENS, where), np.float64).ravel()]
    fisheye = bool(find("fisheye_model")) or find("distortion_model") in ("equidistant", "fisheye")
    if not fisheye and len(k) not in (4, 5, 8, 12, 14):
        k += [0.0] * (4 - len(k))
    return {
        "width": int(_first(find, _WIDTH, where)), "height": int(_first(find, _HEIGHT, where)),
        "fx": matrix[0, 0], "fy": matrix[1, 1],
        "cx": matrix[0, 2] + OPENCV_CENTRES, "cy": matrix[1, 2] + OPENCV_CENTRES,
        "distortion": {"model": "fisheye" if fisheye else "brown", "k": k},
        "world_from_camera": inverted(_rotation(rotation, where), translation),
    }  # fmt: skip


def _rotation(values: F64, where: str) -> F64:
    import cv2

    if values.size == 3:
        return np.asarray(cv2.Rodrigues(values.reshape(3, 1))[0], np.float64)
    if values.size != 9:
        raise JobError("The rotation cannot be read", where, "3 x 3, or a rotation vector", "calibrate again")
    return values.reshape(3, 3)


def _first(find: Find, keys: tuple[str, ...], where: str) -> Any:
    """The value under the first of several names that is there."""
    for key in keys:
        value = find(key)
        if value is not None and np.size(value):
            return value
    raise JobError(
        f"The calibration lacks {keys[0]}", where, f"one of {', '.join(keys)}",
        "add it; of a folder, each file holds one camera with its pose in the common world",
    )  # fmt: skip


def _stored(path: Path) -> dict[str, Any]:
    """All nodes of a FileStorage: matrices as arrays, sequences as lists, numbers and texts."""
    import cv2

    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix.lower() != ".xml" and not text.startswith("%YAML"):
            text = f"%YAML:1.0\n---\n{text.removeprefix('---')}"
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (OSError, UnicodeDecodeError, cv2.error, SystemError) as error:
        raise JobError(
            "The calibration cannot be read as OpenCV's FileStorage", str(path), "a file that cv::FileStorage wrote",
            "write it with OpenCV, or use a cameras.json",
        ) from error  # fmt: skip
    root = storage.root()
    return {key: _value(root.getNode(key)) for key in root.keys()}


def _value(node: Any) -> Any:
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        return [_value(node.at(i)) for i in range(node.size())]
    if node.isMap():
        if "data" in node.keys() and not node.getNode("dt").empty():
            return node.mat()
        if "data" in node.keys():  # ROS writes matrices without OpenCV's tag
            values = np.array(_value(node.getNode("data")), np.float64)
            rows, columns = (int(node.getNode(key).real()) for key in ("rows", "cols"))
            return values.reshape(rows, columns)
    return None
