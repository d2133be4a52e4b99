"""Where the shot's world stands in a scene of Blender."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yesnt.core.camera import Camera

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class ActorPlace:
    """The shot's world in the scene: turned about the vertical, then moved.

    Attributes:
        at: scene metres, where the origin of the shot's world stands.
        yaw: degrees about +Z, counter-clockwise from above.
    """

    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    @property
    def scene_from_world(self) -> Matrix:
        """[4, 4]."""
        angle = np.radians(self.yaw)
        out = np.eye(4)
        out[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        out[:3, 3] = self.at
        return out

    def to_scene(self, point: ArrayLike) -> Matrix:
        """A point [3] of the shot's world, in scene metres."""
        matrix = self.scene_from_world
        return matrix[:3, :3] @ np.asarray(point, dtype=np.float64) + matrix[:3, 3]


def camera_of(camera: Camera, frame: int, place: ActorPlace) -> dict[str, Any]:
    """The shot's camera of a frame as `inside_blender/scenes.py` takes it; the lens must not distort."""
    lens = camera.lens(frame)
    return {
        "width": camera.width, "height": camera.height,
        "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy,
        "scene_from_camera": (place.scene_from_world @ camera.pose(frame)).tolist(),
    }  # fmt: skip
