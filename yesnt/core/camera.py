"""Pinhole cameras in OpenCV axes (+x right, +y down, +z forward) over a Z-up world (method.md section 1)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError

_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")
_ROTATION_TOLERANCE = 1e-3  # cameras come from files with float32 or 5-digit text


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels and one pose a frame; pixel centres lie at +0.5.

    Attributes:
        width: columns.
        height: rows.
        fx: horizontal focal length in pixels.
        fy: vertical focal length in pixels.
        cx: principal point, pixels from the left edge.
        cy: principal point, pixels from the top edge.
        poses: frame number -> `world_from_camera` [4, 4], metres.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    poses: Mapping[int, NDArray[np.float64]]

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
                f"The camera file cannot be read ({error})", str(path), "JSON text", "export it again"
            ) from error
        return cls.from_dict(data, str(path))

    @classmethod
    def from_dict(cls, data: Any, where: str = "camera") -> Camera:
        """Builds a camera from the parsed `camera.json`; `where` names it in errors."""
        if not isinstance(data, dict) or any(key not in data for key in (*_INTRINSICS, "frames")):
            missing = [key for key in (*_INTRINSICS, "frames") if not isinstance(data, dict) or key not in data]
            raise JobError(
                f"The camera lacks {', '.join(missing)}", where, "width, height, fx, fy, cx, cy, frames", "add them"
            )
        numbers = [data[key] for key in _INTRINSICS]
        if not all(isinstance(n, int | float) and np.isfinite(n) for n in numbers) or min(numbers[:4]) <= 0:
            raise JobError(
                "The camera's intrinsics are not usable", f"{where}: {numbers}", "positive finite numbers", "mend them"
            )
        try:
            poses = {int(f): _pose(p["world_from_camera"], f"{where}: frame {f}") for f, p in data["frames"].items()}
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise JobError(
                "A camera pose cannot be read",
                f"{where}: frames",
                '{"1001": {"world_from_camera": [16 numbers]}}',
                "correct it",
            ) from error
        width, height, fx, fy, cx, cy = numbers
        return cls(int(width), int(height), float(fx), float(fy), float(cx), float(cy), MappingProxyType(poses))

    def pose(self, frame: int | None = None) -> NDArray[np.float64]:
        """`world_from_camera` [4, 4] of a frame; None takes the only or the first pose."""
        if frame is None:
            return self.poses[min(self.poses)]
        if frame not in self.poses:
            raise JobError(
                f"The camera has no pose for frame {frame}",
                f"frames {sorted(self.poses)}",
                "one pose a frame",
                "add it",
            )
        return self.poses[frame]

    def position(self, frame: int | None = None) -> NDArray[np.float64]:
        """Centre of projection in world metres, [3]."""
        return self.pose(frame)[:3, 3]

    def rays(self, frame: int | None = None) -> NDArray[np.float32]:
        """World directions through pixel centres, not normalised, with camera z = 1: [H, W, 3].

        `position + z * ray` is the world point at planar depth z.
        """
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None], np.ones((1, 1))), axis=-1)
        return (grid @ self.pose(frame)[:3, :3].T).astype(np.float32)

    def project(self, points: NDArray[np.floating], frame: int | None = None) -> NDArray[np.float64]:
        """World points [..., 3] to pixel x, y and planar depth z: [..., 3]."""
        pose = self.pose(frame)
        local = (np.asarray(points, dtype=np.float64) - pose[:3, 3]) @ pose[:3, :3]
        z = local[..., 2]
        return np.stack([self.fx * local[..., 0] / z + self.cx, self.fy * local[..., 1] / z + self.cy, z], axis=-1)


def _pose(values: Any, where: str) -> NDArray[np.float64]:
    matrix = np.asarray(values, dtype=np.float64).reshape(4, 4)
    rotation = matrix[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not np.isfinite(matrix).all() or off > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise JobError(
            "A camera pose is not a rotation and a translation",
            where,
            "a right-handed 4x4, row-major",
            "export it again",
        )
    matrix.setflags(write=False)
    return matrix
