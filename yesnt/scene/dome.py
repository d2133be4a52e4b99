"""The light's map behind the set: a dome with a flat ground, so that the horizon and the feet agree.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.relight.envmap import EnvMap

F32 = NDArray[np.float32]

EYE_HEIGHT = 1.6
"""Metres above the ground at which a map was captured, where the job does not say: a tripod."""

DISTANCE = 100.0
"""Radius of the dome, metres, where the job does not say."""


@dataclass(frozen=True)
class Dome:
    """A half sphere on a disc.

    Attributes:
        place: [3] world metres, where the map was captured.
        ground: world z of the disc, metres; below `place`.
        radius: of both, metres, about the point of the ground below `place`.
    """

    place: tuple[float, float, float]
    ground: float
    radius: float

    def picture(self, env: EnvMap, camera: Camera, frame: int) -> F32:
        """The map as the camera sees it, projected onto the dome from its place, [H, W, 3]."""
        rays = camera.rays(frame).astype(np.float64)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        eye = camera.position(frame) - np.array([*self.place[:2], self.ground])
        to_sphere = _reach(rays, eye, self.radius)
        to_ground = -eye[2] / np.where(rays[..., 2] < 0, rays[..., 2], np.inf)
        on_ground = (rays[..., 2] < 0) & (to_ground >= 0) & (to_ground < to_sphere)
        point = eye + rays * np.where(on_ground, to_ground, to_sphere)[..., None]
        return env.lookup(point - np.array([0, 0, self.place[2] - self.ground]))


def _reach(rays: NDArray[np.float64], eye: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Distance along unit rays [..., 3] to a sphere about the origin; an eye outside counts as just inside."""
    at = eye * min(1.0, 0.999 * radius / max(float(np.linalg.norm(eye)), 1e-9))
    along = rays @ at
    return -along + np.sqrt(along**2 - at @ at + radius**2)
