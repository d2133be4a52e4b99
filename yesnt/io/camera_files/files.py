"""Reads a camera from a file of any kind that is understood, and writes `camera.json`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from yesnt.core.camera import Camera
from yesnt.core.camera_document import Lens
from yesnt.core.errors import JobError
from yesnt.io.calibrations.nerfstudio import is_transforms
from yesnt.io.calibrations.registry import CALIBRATIONS
from yesnt.io.camera_files.alembic import read_alembic
from yesnt.io.camera_files.chan import read_chan
from yesnt.io.camera_files.options import ImportOptions
from yesnt.io.camera_files.usd import read_usd
from yesnt.io.cameras import read_cameras
from yesnt.io.durable import write_bytes

USD = (".usd", ".usda", ".usdc", ".usdz")
SUFFIXES = (".json", ".chan", ".abc", *USD)


def read_cameras_of(path: Path, options: ImportOptions) -> dict[str, Camera]:
    """The cameras of a file by name: all of a `cameras.json`, or the one of a `camera.json` or another program's file.

    Raises:
        JobError: the file cannot be read, or is of no kind that is understood.
        UsageError: the file leaves out what the options do not say either.
        MissingPartError: a library that reads the file is absent.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        return _of_json(path, options.camera)
    readers = {".chan": read_chan, ".abc": read_alembic, **dict.fromkeys(USD, read_usd)}
    if suffix not in readers and any(kind.files(path) for kind in CALIBRATIONS):
        return _of_capture(path, options.camera)
    if suffix not in readers:
        raise JobError(
            f"A camera file of the kind {suffix or 'without a suffix'} is not understood", str(path),
            f"one of {', '.join(SUFFIXES)}, or a calibration of COLMAP, Qualisys or OpenCV",
            "export one; `yesnt camera --blender-script` prints a script for Blender",
        )  # fmt: skip
    return {path.stem: Camera.from_dict(readers[suffix](path, options), str(path))}


def _of_json(path: Path, wanted: str | None) -> dict[str, Camera]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        several = "cameras" in data or is_transforms(data)
    except (OSError, ValueError, TypeError):
        several = False  # `Camera.open` says what is wrong
    return _of_capture(path, wanted) if several else {path.stem: Camera.open(path)}


def _of_capture(path: Path, wanted: str | None) -> dict[str, Camera]:
    found = {name: one.camera for name, one in read_cameras(path).items() if wanted in (None, name)}
    if not found:
        raise JobError(f"The file has no camera {wanted!r}", str(path), "a name of its cameras", "check its spelling")
    return found


def document_of(camera: Camera, source: str) -> dict[str, Any]:
    """`camera.json` of a camera, in OpenCV axes and metres; keys that equal their defaults are left out."""
    first = camera.lens()
    frames: dict[str, Any] = {}
    for frame, pose in sorted(camera.poses.items()):
        own, common = _lens_keys(camera.lens(frame)), _lens_keys(first)
        frames[str(frame)] = {
            "world_from_camera": pose.ravel().tolist(),
            **{key: value for key, value in own.items() if value != common[key]},
        }
    lens = {key: value for key, value in _lens_keys(first).items() if key != "distortion" or first.distortion.k}
    return {"source": source, "width": camera.width, "height": camera.height, **lens, "frames": frames}


def _lens_keys(lens: Lens) -> dict[str, Any]:
    distortion = {"model": lens.distortion.model, "k": list(lens.distortion.k)}
    return {"fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "distortion": distortion}


def write_camera(path: Path, camera: Camera, source: str) -> None:
    """Writes `camera.json`, replacing another one at once."""
    write_bytes(path, (json.dumps(document_of(camera, source), indent=1) + "\n").encode())


def blender_script() -> str:
    """The script that exports a camera from Blender."""
    return (Path(__file__).parent / "inside_blender" / "export_camera.py").read_text(encoding="utf-8")
