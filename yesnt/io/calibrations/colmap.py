"""COLMAP's cameras and images, as text or binary (https://colmap.github.io/format.html).

COLMAP's cameras look along +z with +y down, as ours; poses take the world to the camera; the corner of the first pixel
is 0, as here. Its world has no unit and no up: the job's `units` and `up` say them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO

import numpy as np

from yesnt.core.errors import JobError
from yesnt.io.calibrations.document import Document, by_camera, inverted, of_quaternion

FOLDERS = (".", "sparse/0", "sparse", "0")
"""Where a model lies below the folder that is named."""

MODELS: Mapping[str, tuple[int, int, str | None]] = MappingProxyType({
    "SIMPLE_PINHOLE": (0, 3, "none"), "PINHOLE": (1, 4, "none"), "SIMPLE_RADIAL": (2, 4, "brown"),
    "RADIAL": (3, 5, "brown"), "OPENCV": (4, 8, "brown"), "OPENCV_FISHEYE": (5, 8, "fisheye"),
    "FULL_OPENCV": (6, 12, "brown"), "FOV": (7, 5, None), "SIMPLE_RADIAL_FISHEYE": (8, 4, "fisheye"),
    "RADIAL_FISHEYE": (9, 5, "fisheye"), "THIN_PRISM_FISHEYE": (10, 12, None),
})  # fmt: skip
"""Camera models: number in binary files, count of parameters, our model (None: it has no counterpart)."""

_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_EXPECTED = "a folder with cameras.bin and images.bin, or cameras.txt and images.txt"


def find_files(path: Path) -> tuple[Path, ...]:
    """The files of the cameras and of the images at or below a path, binary ones first; none if it is no model."""
    if path.is_file():
        pair = path, path.with_name(f"images{path.suffix}")
        return pair if path.stem == "cameras" and path.suffix in (".bin", ".txt") and pair[1].is_file() else ()
    for folder in FOLDERS:
        for suffix in (".bin", ".txt"):
            pair = path / folder / f"cameras{suffix}", path / folder / f"images{suffix}"
            if all(file.is_file() for file in pair):
                return pair
    return ()


def read_colmap(path: Path) -> Document:
    """A COLMAP model as the document of `cameras.json`, named by the files of its images.

    Raises:
        JobError: a file cannot be read, or a camera model has no counterpart.
    """
    cameras_file, images_file = find_files(path)
    binary = cameras_file.suffix == ".bin"
    lenses = dict((_cameras_binary if binary else _cameras_text)(cameras_file))
    entries = []
    for name, number, pose in (_images_binary if binary else _images_text)(images_file):
        if number not in lenses:
            raise JobError(f"The image {name} has no camera {number}", str(images_file), _EXPECTED, "export it again")
        entries.append((name, lenses[number] | {"world_from_camera": pose}))
    if not entries:
        raise JobError("The model has no images", str(images_file), "at least one registered image", "calibrate again")
    return {"axes": "opencv", "cameras": by_camera(entries, str(images_file))}


def _entry(model: str, size: tuple[int, int], values: tuple[float, ...], where: str) -> Document:
    known = MODELS.get(model)
    if known is None or known[2] is None or len(values) != known[1]:
        raise JobError(
            f"The camera model {model} with {len(values)} parameters cannot be used", where,
            f"one of {', '.join(name for name, row in MODELS.items() if row[2])}",
            "undistort with `colmap image_undistorter`, which writes PINHOLE cameras",
        )  # fmt: skip
    focal = (values[0], *values) if model in _ONE_FOCAL else values
    fx, fy, cx, cy, *k = focal
    entry: Document = {"width": size[0], "height": size[1], "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    if known[2] != "none":
        # k1 k2 p1 p2 k3 k4 k5 k6 is OpenCV's own order; the radial models stop after k1 or k2.
        entry["distortion"] = {"model": known[2], "k": [*k, *[0.0] * (4 - len(k))]}
        if model == "FULL_OPENCV":
            entry["distortion"]["k"] = list(k)
    return entry


def _cameras_text(path: Path) -> Iterator[tuple[int, Document]]:
    for number, line in _lines(path, skip_blank=True):
        where = f"{path}, line {number}"
        try:
            key, model, width, height, *values = line.split()
            size, parameters = (int(width), int(height)), tuple(float(v) for v in values)
            named = int(key)
        except ValueError as error:
            raise JobError(
                "The line is no camera", where, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS...", "export it again"
            ) from error
        yield named, _entry(model, size, parameters, where)


def _images_text(path: Path) -> Iterator[tuple[str, int, list[float]]]:
    """Every second line is an image; the other holds its points and may be empty."""
    lines = [(number, line) for number, line in _lines(path, skip_blank=False)]
    while lines and not lines[0][1].strip():
        lines.pop(0)
    for number, line in lines[::2]:
        if not line.strip():
            continue
        try:
            _, *numbers, camera, name = line.strip().split(maxsplit=9)
            pose, key = _pose([float(v) for v in numbers]), int(camera)
        except ValueError as error:
            raise JobError(
                "The line is no image", f"{path}, line {number}", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
                "export it again",
            ) from error  # fmt: skip
        yield name, key, pose


def _lines(path: Path, skip_blank: bool) -> Iterator[tuple[int, str]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise JobError(f"The calibration cannot be read ({error})", str(path), _EXPECTED, "export it again") from error
    kept = ((number, line) for number, line in enumerate(lines, 1) if not line.startswith("#"))
    return ((number, line) for number, line in kept if line.strip() or not skip_blank)


def _pose(numbers: list[float]) -> list[float]:
    """`world_from_camera` of quaternion w, x, y, z and translation."""
    if len(numbers) != 7 or not any(numbers[:4]):
        raise ValueError("no pose")
    return inverted(of_quaternion(*numbers[:4]), np.array(numbers[4:]))


def _cameras_binary(path: Path) -> list[tuple[int, Document]]:
    names = {row[0]: name for name, row in MODELS.items()}

    def one(stream: BinaryIO) -> tuple[int, Document]:
        key, model, width, height = _take(stream, "<iiQQ")
        name, where = names.get(model, f"number {model}"), f"{path}: camera {key}"
        count = MODELS[name][1] if name in MODELS else 0
        return key, _entry(name, (width, height), _take(stream, f"<{count}d"), where)

    return _records(path, one)


def _images_binary(path: Path) -> list[tuple[str, int, list[float]]]:
    def one(stream: BinaryIO) -> tuple[str, int, list[float]]:
        _, *numbers, key = _take(stream, "<I7dI")
        name = bytearray()
        while (letter := stream.read(1)) != b"\0":
            if not letter:
                raise struct.error("the name of an image does not end")
            name += letter
        (points,) = _take(stream, "<Q")
        stream.seek(24 * points, 1)
        return name.decode(), key, _pose(list(numbers))

    return _records(path, one)


def _records(path: Path, read: Callable[[BinaryIO], Any]) -> list[Any]:
    """All records of a binary file, whose first eight bytes are their number."""
    try:
        with path.open("rb") as stream:
            (count,) = _take(stream, "<Q")
            return [read(stream) for _ in range(count)]
    except (OSError, struct.error, ValueError) as error:
        raise JobError(f"The calibration cannot be read ({error})", str(path), _EXPECTED, "export it again") from error


def _take(stream: BinaryIO, form: str) -> tuple[Any, ...]:
    return struct.unpack(form, stream.read(struct.calcsize(form)))
