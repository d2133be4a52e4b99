"""Qualisys Track Manager's calibration (.qca.txt, an XML text).

Lengths are millimetres. Intrinsics are 64ths of a pixel of the whole sensor, with the centre of the first pixel at 0;
`fov_video` is the part that was recorded. The rows of the rotation are the camera's axes in the world: x right, y up,
z back, as OpenGL's. Radial and tangential distortion are OpenCV's first coefficients.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from yesnt.core.errors import JobError
from yesnt.io.calibrations.document import OPENCV_CENTRES, Document

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SUBPIXELS = 64.0
"""Units of the intrinsics in a pixel."""

_EXPECTED = "a calibration of Qualisys Track Manager with its cameras' fov_video, transform and intrinsic"
_ROTATION = [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]


def is_qualisys(head: str) -> bool:
    """Whether a text file that begins so is such a calibration."""
    return "<calibration" in head and "qtm-version" in head


def read_qualisys(path: Path) -> Document:
    """A Qualisys calibration as the document of `cameras.json`; cameras are named by their serial numbers.

    Raises:
        JobError: the file cannot be read, or a camera lacks a part or was turned in the program's view.
    """
    from xml.etree import ElementTree

    try:
        root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        raise JobError(f"The calibration cannot be read ({error})", str(path), _EXPECTED, "export it again") from error
    cameras = {}
    for number, camera in enumerate(root.iter("camera")):
        name = camera.get("serial") or f"camera{number + 1}"
        where = f"{path}: camera {name}"
        try:
            cameras[name] = _entry(camera, where)
        except (KeyError, ValueError) as error:
            raise JobError(f"The camera lacks a number ({error})", where, _EXPECTED, "export it again") from error
    if not cameras:
        raise JobError("The calibration has no cameras", str(path), _EXPECTED, "export it again")
    return {"axes": "opengl", "units": "mm", "cameras": cameras}


def _entry(camera: Element, where: str) -> Document:
    turned = float(camera.get("viewrotation", "0"))
    if turned:
        raise JobError(
            f"The camera's view is turned by {turned:g} degrees", where, "viewrotation 0",
            "set the camera's rotation to 0 in Qualisys Track Manager and export again",
        )  # fmt: skip
    window, place, lens = (_part(camera, name) for name in ("fov_video", "transform", "intrinsic"))
    left, top, right, bottom = (float(window[key]) for key in ("left", "top", "right", "bottom"))
    pose = np.eye(4)
    pose[:3, :3] = np.array([float(place[key]) for key in _ROTATION]).reshape(3, 3).T
    pose[:3, 3] = [float(place[key]) for key in "xyz"]
    if float(lens.get("skew", 0)):
        raise ValueError("a skew other than 0 cannot be used")
    k = [float(lens[f"radialDistortion{i}"]) for i in (1, 2)]
    k += [float(lens[f"tangentalDistortion{i}"]) for i in (1, 2)]
    k += [float(lens.get("radialDistortion3", 0))]
    return {
        "width": int(right - left + 1), "height": int(bottom - top + 1),
        "fx": float(lens["focalLengthU"]) / SUBPIXELS, "fy": float(lens["focalLengthV"]) / SUBPIXELS,
        "cx": float(lens["centerPointU"]) / SUBPIXELS - left + OPENCV_CENTRES,
        "cy": float(lens["centerPointV"]) / SUBPIXELS - top + OPENCV_CENTRES,
        "distortion": {"model": "brown", "k": k}, "world_from_camera": pose.ravel().tolist(),
    }  # fmt: skip


def _part(camera: Element, name: str) -> dict[str, str]:
    found = camera.find(name)
    if found is None:
        raise KeyError(name)
    return dict(found.attrib)
