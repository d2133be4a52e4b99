"""Undoes the distortion of a capture's lenses once, when a picture is read: what follows knows pinhole cameras alone.

The undistorted picture keeps the focal lengths. Its window is the largest that has a source at every pixel, so that no
pixel is invented and none needs a mask; corners that a barrel distortion draws outward are cut off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.camera_document import Lens
from yesnt.core.distortion import UNDISTORTED
from yesnt.core.errors import JobError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

MOST_PIXELS = 4.0
"""Largest number of pixels of an undistorted picture, as a multiple of the stored one's: a wider lens is refused."""


@dataclass(frozen=True)
class Resampling:
    """How an undistorted picture is read from the stored one.

    Attributes:
        left, top: first column and row of the undistorted picture in the pixels of a pinhole of the same lens.
        x, y: [H, W] float32 columns and rows of the stored picture, for OpenCV (the centre of the first pixel is 0).
    """

    left: int
    top: int
    x: F32
    y: F32

    def apply(self, image: F32) -> F32:
        """An image [h, w] or [h, w, C] undistorted, [H, W] or [H, W, C]; between pixels it is linear."""
        import cv2

        return np.asarray(cv2.remap(image, self.x, self.y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def resampling(camera: Camera, pose: int | None, where: str) -> Resampling | None:
    """The resampling of a frame's picture; None where the lens does not distort.

    Args:
        camera: the camera.
        pose: what `Camera.pose` takes.
        where: names the camera in errors.

    Raises:
        JobError: the lens shows nothing at some pixel, or sees too wide for one plane.
    """
    lens = camera.lens(pose)
    return _resampling(lens, (camera.width, camera.height), where) if lens.distortion.acts else None


def undistorted_camera(camera: Camera, pose: int | None, taken: Resampling) -> Camera:
    """The pinhole camera of an undistorted picture, with the one pose of its frame."""
    lens, (height, width) = camera.lens(pose), taken.x.shape
    frame = min(camera.poses) if pose is None else pose
    return replace(
        camera, width=width, height=height, fx=lens.fx, fy=lens.fy, cx=lens.cx - taken.left, cy=lens.cy - taken.top,
        poses=MappingProxyType({frame: camera.pose(pose)}), distortion=UNDISTORTED, lenses=MappingProxyType({}),
    )  # fmt: skip


def restoring(camera: Camera, pose: int | None, taken: Resampling) -> Resampling:
    """How the stored picture of a frame is read from its undistorted one, whose border is repeated around it."""
    lens = camera.lens(pose)
    u, v = ((np.arange(side) + 0.5 - c) / f for side, c, f in
            ((camera.width, lens.cx, lens.fx), (camera.height, lens.cy, lens.fy)))  # fmt: skip
    x, y = lens.distortion.undistort(*np.meshgrid(u, v))
    maps = (lens.fx * x + lens.cx - taken.left - 0.5, lens.fy * y + lens.cy - taken.top - 0.5)
    return Resampling(-taken.left, -taken.top, *(np.ascontiguousarray(part, np.float32) for part in maps))


@lru_cache(maxsize=32)
def _resampling(lens: Lens, size: tuple[int, int], where: str) -> Resampling:
    left, top, right, bottom = _window(lens, size, where)
    x = (np.arange(left, right) + 0.5 - lens.cx) / lens.fx
    y = (np.arange(top, bottom) + 0.5 - lens.cy) / lens.fy
    bent_x, bent_y = lens.distortion.distort(*np.meshgrid(x, y))
    maps = (lens.fx * bent_x + lens.cx - 0.5, lens.fy * bent_y + lens.cy - 0.5)
    return Resampling(left, top, *(np.ascontiguousarray(part, np.float32) for part in maps))


def _window(lens: Lens, size: tuple[int, int], where: str) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the largest window of the pinhole's pixels that the stored picture fills."""
    # Up to the centres of the outermost pixels: beyond them the picture has no colour.
    across, down = (np.arange(side, dtype=np.float64) + 0.5 for side in size)

    def straight(x: F64, y: F64) -> tuple[F64, F64]:
        u, v = lens.distortion.undistort((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy)
        return lens.fx * u + lens.cx, lens.fy * v + lens.cy

    first, last = np.full_like(down, 0.5), np.full_like(down, size[0] - 0.5)
    upper, lower = np.full_like(across, 0.5), np.full_like(across, size[1] - 0.5)
    left, right = np.max(straight(first, down)[0]), np.min(straight(last, down)[0])
    top, bottom = np.max(straight(across, upper)[1]), np.min(straight(across, lower)[1])
    edges = np.array([left - 0.5, top - 0.5, right + 0.5, bottom + 0.5])
    if not np.isfinite(edges).all() or left >= right or top >= bottom:
        raise JobError(
            "The lens's distortion cannot be undone in the whole picture", where,
            "a distortion that can be inverted, less than 90 degrees off the axis",
            "check its coefficients, or undistort the pictures with the program that calibrated them",
        )  # fmt: skip
    pixels = (edges[2] - edges[0]) * (edges[3] - edges[1])
    if pixels > MOST_PIXELS * size[0] * size[1]:
        raise JobError(
            f"The lens sees so wide that its picture on a plane has {pixels / size[0] / size[1]:.0f} times the pixels",
            where, f"at most {MOST_PIXELS:g} times", "undistort the pictures to a narrower view and calibrate these",
        )  # fmt: skip
    begin, end = np.ceil(edges[:2] - 1e-6).astype(int), np.floor(edges[2:] + 1e-6).astype(int)
    return int(begin[0]), int(begin[1]), int(end[0]), int(end[1])
