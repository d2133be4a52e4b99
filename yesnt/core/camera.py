"""Cameras in OpenCV axes (+x right, +y down, +z forward) over a Z-up world (method.md section 1)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera_document import CameraDocument, Lens, read_document
from yesnt.core.distortion import UNDISTORTED, Distortion
from yesnt.core.errors import JobError
from yesnt.core.frame_ranges import frame_ranges


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels, lens distortion and one pose a frame; pixel centres lie at +0.5.

    Attributes:
        width: columns.
        height: rows.
        fx: horizontal focal length in pixels.
        fy: vertical focal length in pixels.
        cx: principal point, pixels from the left edge.
        cy: principal point, pixels from the top edge.
        poses: frame number -> `world_from_camera` [4, 4], metres.
        distortion: of the lens.
        lenses: frame number -> lens, for frames that have another one (a zoom).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    poses: Mapping[int, NDArray[np.float64]]
    distortion: Distortion = UNDISTORTED
    lenses: Mapping[int, Lens] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def open(cls, path: str | Path) -> Camera:
        """Reads `camera.json` (contract.md).

        Raises:
            JobError: the file is missing, is not JSON, or a key is absent or wrong.
        """
        try:
            data = json.loads(Path(path).read_text())
        except FileNotFoundError as error:
            raise JobError(
                "The camera file is missing", str(path), "a camera.json", "write it, or mend `camera:`"
            ) from error
        except (ValueError, OSError) as error:
            raise JobError(
                f"The camera file cannot be read ({error})", str(path), "JSON text",
                "export it again; `yesnt camera FILE --write camera.json` converts .chan, Alembic and USD",
            ) from error  # fmt: skip
        return cls.from_dict(data, str(path))

    @classmethod
    def from_dict(cls, data: Any, where: str = "camera") -> Camera:
        """Builds a camera from the parsed `camera.json`; `where` names it in errors."""
        return cls.from_document(read_document(data, where))

    @classmethod
    def from_document(cls, document: CameraDocument) -> Camera:
        """Builds a camera from a checked document."""
        lenses, (width, height) = document.lenses, document.size
        first = lenses[min(lenses)]
        others = MappingProxyType({frame: lens for frame, lens in lenses.items() if lens != first})
        poses = MappingProxyType(dict(document.poses))
        return cls(width, height, first.fx, first.fy, first.cx, first.cy, poses, first.distortion, others)

    def lens(self, frame: int | None = None) -> Lens:
        """Intrinsics and distortion of a frame; None takes the only or the first pose's."""
        frame = min(self.poses) if frame is None else frame
        own = self.lenses.get(frame)
        return own or Lens(self.fx, self.fy, self.cx, self.cy, self.distortion)

    def windowed(self, left: float, top: float, width: int, height: int) -> Camera:
        """The same camera for a window of its picture, or for one that is larger.

        Args:
            left: column of this camera at which the window begins; negative for overscan.
            top: row at which it begins.
            width: columns of the window.
            height: rows of the window.
        """
        lenses = {f: replace(lens, cx=lens.cx - left, cy=lens.cy - top) for f, lens in self.lenses.items()}
        return replace(
            self, width=width, height=height, cx=self.cx - left, cy=self.cy - top, lenses=MappingProxyType(lenses)
        )

    def pose(self, frame: int | None = None) -> NDArray[np.float64]:
        """`world_from_camera` [4, 4] of a frame; None takes the only or the first pose."""
        if frame is None:
            return self.poses[min(self.poses)]
        if frame not in self.poses:
            raise JobError(
                f"The camera has no pose for frame {frame}",
                f"camera.json, key frames: it has {frame_ranges(self.poses)}",
                "one pose a frame",
                "add it",
            )
        return self.poses[frame]

    def check(self, frames: Iterable[int]) -> None:
        """Refuses a camera that cannot serve some frame.

        Raises:
            JobError: a frame has no pose, or its lens shows nothing at some pixel.
        """
        for frame in frames:
            self.pose(frame)
            lens = self.lens(frame)
            if lens.distortion.acts:
                lens_reach(lens, (self.width, self.height))

    def position(self, frame: int | None = None) -> NDArray[np.float64]:
        """Centre of projection in world metres, [3]."""
        return self.pose(frame)[:3, 3]

    def rays(self, frame: int | None = None) -> NDArray[np.float32]:
        """World directions through pixel centres, not normalised, with camera z = 1: [H, W, 3].

        `position + z * ray` is the world point at planar depth z. The lens's distortion is undone.

        Raises:
            JobError: the lens shows nothing in front of it at some pixel.
        """
        lens, size = self.lens(frame), (self.width, self.height)
        x, y = _undistorted(lens, size) if lens.distortion.acts else _pinhole(lens, size)
        grid = np.stack(np.broadcast_arrays(x, y, np.ones((1, 1))), axis=-1)
        return (grid @ self.pose(frame)[:3, :3].T).astype(np.float32)

    def project(self, points: NDArray[np.floating], frame: int | None = None) -> NDArray[np.float64]:
        """World points [..., 3] to pixel x, y and planar depth z: [..., 3].

        Behind a lens that distorts, or outside its field, x and y are NaN: its polynomial has no meaning there.
        """
        pose, lens = self.pose(frame), self.lens(frame)
        local = (np.asarray(points, dtype=np.float64) - pose[:3, 3]) @ pose[:3, :3]
        z = local[..., 2]
        x, y = local[..., 0] / z, local[..., 1] / z
        if lens.distortion.acts:
            known = (z > 0) & (np.hypot(x, y) <= lens_reach(lens, (self.width, self.height)))
            x, y = (np.where(known, part, np.nan) for part in lens.distortion.distort(x, y))
            return np.stack([lens.fx * x + lens.cx, lens.fy * y + lens.cy, z], axis=-1)
        return np.stack([lens.fx * local[..., 0] / z + lens.cx, lens.fy * local[..., 1] / z + lens.cy, z], axis=-1)


def lens_reach(lens: Lens, size: tuple[int, int]) -> float:
    """Largest distance from the axis, on the plane z = 1, of what a picture of a size (width, height) shows.

    Raises:
        JobError: as `Camera.rays`.
    """
    x, y = _border(lens, size)
    _refuse_dark(x, lens, "border")
    return 1.001 * float(np.hypot(x, y).max())


@lru_cache(maxsize=8)
def _border(lens: Lens, size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Undistorted corners of the pixels at the border of a picture, [P] each."""
    across, down = np.arange(size[0] + 1.0), np.arange(size[1] + 1.0)
    x = np.concatenate([across, across, 0 * down, 0 * down + size[0]])
    y = np.concatenate([0 * across, 0 * across + size[1], down, down])
    return lens.distortion.undistort((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy)


def _pinhole(lens: Lens, size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixel centres on the plane z = 1: x [1, W] and y [H, 1]."""
    x = (np.arange(size[0], dtype=np.float64) + 0.5 - lens.cx) / lens.fx
    y = (np.arange(size[1], dtype=np.float64) + 0.5 - lens.cy) / lens.fy
    return x[None, :], y[:, None]


@lru_cache(maxsize=1)
def _undistorted(lens: Lens, size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same behind a lens: x and y [H, W]. Kept, since a shot's frames share a lens."""
    rows = [lens.distortion.undistort(*np.broadcast_arrays(*part)) for part in _rows(lens, size)]
    x, y = (np.concatenate(part) for part in zip(*rows, strict=True))
    _refuse_dark(x, lens, "picture")
    return x, y


def _refuse_dark(x: NDArray[np.float64], lens: Lens, where: str) -> None:
    """Raises JobError where an undistorted x is NaN."""
    share = float(np.isnan(x).mean())
    if share > 0:
        raise JobError(
            f"The lens shows nothing in front of it at {100 * share:.3g} % of the pixels of the {where}",
            f"camera: distortion {lens.distortion.model} {list(lens.distortion.k)}, fx {lens.fx:g}, fy {lens.fy:g}",
            "a distortion that can be inverted in the whole picture, less than 90 degrees off the axis",
            "check the order of `k` and the unit of fx and fy, or undistort the pictures and set the model to none",
        )


def _rows(lens: Lens, size: tuple[int, int]) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Pinhole directions in bands of rows that stay in the processor's cache."""
    x, y = _pinhole(lens, size)
    return [(x, y[i : i + 16]) for i in range(0, size[1], 16)]
