"""The kinds of calibrations that `capture.cameras` may name, found by their content."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.errors import JobError
from yesnt.io.calibrations import colmap, opencv
from yesnt.io.calibrations.document import Document
from yesnt.io.calibrations.nerfstudio import is_transforms, read_transforms
from yesnt.io.calibrations.qualisys import is_qualisys, read_qualisys

_HEAD_BYTES = 4096

NO_FILES: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Calibration:
    """A kind of calibration.

    Attributes:
        name: for messages.
        files: the files that a path stands for; empty if they are not of this kind.
        read: the document of `cameras.json` of a path of this kind.
    """

    name: str
    files: Callable[[Path], tuple[Path, ...]]
    read: Callable[[Path], Document]


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8")) if path.suffix.lower() == ".json" else None
    except (OSError, ValueError):
        return None


def _transforms_file(path: Path) -> tuple[Path, ...]:
    file = path / "transforms.json" if path.is_dir() else path
    return (file,) if is_transforms(_json(file)) else NO_FILES


def _qualisys_file(path: Path) -> tuple[Path, ...]:
    if not path.is_file():
        return NO_FILES
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES).decode("utf-8", "replace")
    return (path,) if is_qualisys(head) else NO_FILES


def _own_file(path: Path) -> tuple[Path, ...]:
    return (path,) if path.suffix.lower() == ".json" and not path.is_dir() else NO_FILES


def read_own(path: Path) -> Document:
    """The parsed text of a `cameras.json`.

    Raises:
        JobError: it is missing, or no JSON.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise JobError("The file of the cameras is missing", str(path), "a cameras.json", "write it") from error
    except (ValueError, OSError) as error:
        raise JobError(
            f"The file of the cameras cannot be read ({error})", str(path), "JSON text", "export it again"
        ) from error
    return data if isinstance(data, dict) else {}


CALIBRATIONS = (
    Calibration("COLMAP", colmap.find_files, colmap.read_colmap),
    Calibration(
        "nerfstudio transforms.json", _transforms_file, lambda path: read_transforms(_transforms_file(path)[0])
    ),
    Calibration("cameras.json", _own_file, read_own),
    Calibration("Qualisys .qca.txt", _qualisys_file, read_qualisys),
    Calibration("OpenCV YAML", opencv.find_files, opencv.read_opencv),
)
"""All kinds; the first that knows a path reads it."""


def calibration_of(path: Path) -> Calibration:
    """The kind of the calibration at a path.

    Raises:
        JobError: there is nothing, or nothing that is understood.
    """
    for kind in CALIBRATIONS:
        if kind.files(path):
            return kind
    what = "is of no kind that is understood" if path.exists() else "is missing"
    raise JobError(
        f"The calibration of the cameras {what}", str(path),
        f"one of {', '.join(kind.name for kind in CALIBRATIONS)}", "check the path, or export one of these",
    )  # fmt: skip


def calibration_files(path: Path) -> tuple[Path, ...]:
    """The files that a calibration consists of.

    Raises:
        JobError: as `calibration_of`.
    """
    return calibration_of(path).files(path)
