"""A ground plane with a box on it, seen by a camera above; the box sends out one radiance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.relight.scenes import box_mesh
from yesnt.core.camera import Camera
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.surroundings import SetMaterial
from yesnt.scene.ground import Ground
from yesnt.scene.set_scene import SetScene
from yesnt.scene.set_view import ground_image

GROUND = Ground(0.0, (0.0, 0.0), 0.5, 20.0)


@dataclass(frozen=True)
class UniformSubject:
    """Sends the same radiance everywhere."""

    mesh: ProxyScene
    radiance: float

    def coarse(self, face, direction):
        return np.where((face >= 0)[:, None], np.float32(self.radiance), np.zeros((len(face), 3), np.float32))

    def mirrored(self, hits, grid):
        return self.fine(hits)

    def fine(self, hits):
        return np.full((len(hits.face), 3), self.radiance, np.float32)


def camera(size=(24, 32)):
    """At (0, -4, 2), looking along +Y and 22 degrees down, Z up."""
    down = np.arctan2(1.6, 4.0)
    forward, right = np.array([0, np.cos(down), -np.sin(down)]), np.array([1.0, 0, 0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, (0, -4, 2)
    height, width = size
    return Camera(width, height, 1.2 * width, 1.2 * width, width / 2, height / 2, {1: pose})


def material(color=0.5, roughness=0.8, metallic=0.0):
    return SetMaterial(np.broadcast_to(np.float32(color), 3).copy(), roughness, metallic)


def box(low=(-0.4, -0.4, 0.0), high=(0.4, 0.4, 1.0)):
    return ProxyScene.from_arrays(*box_mesh(low, high))


def scene(radiance=0.0, mesh=None):
    return SetScene(UniformSubject(box() if mesh is None else mesh, radiance), None, 0.002)


def view(given=None, cam=None):
    return ground_image(GROUND, material() if given is None else given, camera() if cam is None else cam, 1).view
