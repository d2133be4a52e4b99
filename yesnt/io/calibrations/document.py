"""Parts of the document of `cameras.json` that the readers of calibrations share (docs/capture.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError

F64 = NDArray[np.float64]
Document = dict[str, Any]

OPENCV_CENTRES = 0.5
"""Added to a principal point whose program puts the centre of the first pixel at 0: ours lies at 0.5."""

_FRAME = re.compile(r"(\d+)$")
_SAME = 1e-9


def inverted(rotation: F64, translation: F64) -> list[float]:
    """`world_from_camera`, 16 numbers, of a rotation [3, 3] and translation [3] that take world points to a camera."""
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ translation
    return [float(v) for v in pose.ravel()]


def of_quaternion(w: float, x: float, y: float, z: float) -> F64:
    """Rotation [3, 3] of a quaternion, which need not have unit length."""
    w, x, y, z = np.array([w, x, y, z]) / np.sqrt(w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def by_camera(entries: Sequence[tuple[str, Document]], where: str) -> Document:
    """Cameras by name from pictures with a pose each.

    Folders that all pictures share are left out. What then has a folder of its own is named by it, else by the file
    without its suffix: `cam01.png` and `cam01/0001.png` both are cam01. Several pictures of one camera with one pose
    are a camera at rest; with several poses their last numbers are its frames.

    Args:
        entries: name of the picture's file and the camera's entry with `world_from_camera`.
        where: names the file in errors.

    Raises:
        JobError: the pictures of a moving camera have no frame numbers, or share one.
    """
    paths = [tuple(part for part in re.split(r"[/\\]", name) if part != ".") for name, _ in entries]
    common = _common_folders(paths)
    found: dict[str, list[tuple[str, Document]]] = {}
    for path, (_, entry) in zip(paths, entries, strict=True):
        own = path[common:]
        stem = own[-1].rpartition(".")[0] or own[-1]
        found.setdefault(own[0] if len(own) > 1 else stem, []).append((stem, entry))
    return {name: _merged(name, pictures, where) for name, pictures in sorted(found.items())}


def _common_folders(paths: Sequence[tuple[str, ...]]) -> int:
    """How many folders all paths share; a single folder of several frames is a camera and stays."""
    folders = [path[:-1] for path in paths]
    count = 0
    while all(len(f) > count for f in folders) and len({f[count] for f in folders}) == 1:
        count += 1
    return count


def _merged(name: str, pictures: Sequence[tuple[str, Document]], where: str) -> Document:
    first = pictures[0][1]
    if all(_same(entry, first) for _, entry in pictures):
        return first
    frames: dict[str, Any] = {}
    for stem, entry in pictures:
        number = _FRAME.search(stem)
        if number is None or str(int(number[1])) in frames:
            raise JobError(
                f"Camera {name} has several poses, and its pictures do not number the frames", f"{where}: {stem}",
                "names that end in the frame's number, or one pose", "rename the pictures and calibrate again",
            )  # fmt: skip
        frames[str(int(number[1]))] = {key: value for key, value in entry.items() if key not in ("width", "height")}
    size = {key: first[key] for key in ("width", "height")}
    return size | {"frames": dict(sorted(frames.items(), key=lambda item: int(item[0])))}


def _same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    near = np.allclose(one["world_from_camera"], other["world_from_camera"], rtol=0, atol=_SAME)
    return near and all(one[key] == other[key] for key in one if key != "world_from_camera")
