"""A ball of one material above a ground, seen by cameras around it, as the set sees it."""

from __future__ import annotations

import numpy as np
import trimesh

from tests.scene.set_scenes import material
from yesnt.capture_stage.cameras import look_at
from yesnt.core.camera import Camera
from yesnt.relight.points import Surface
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.surroundings import Surroundings
from yesnt.scene.delivered_picture import hits_of
from yesnt.scene.ground import Ground
from yesnt.scene.mesh_normals import smooth_normals
from yesnt.scene.set_frame import RelitSubject

BASE = np.float32([0.6, 0.4, 0.2])


def mesh():
    """Of radius 0.5, 1 m above the ground."""
    made = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    return ProxyScene.from_arrays(made.vertices + np.float32([0, 0, 1]), made.faces)


def camera(place, size=24):
    return Camera(size, size, 2.5 * size, 2.5 * size, size / 2, size / 2, {1: look_at(list(place), [0, 0, 1])})


def rays(cam):
    """Origins and unit directions [H W, 3]."""
    aim = cam.rays(1).reshape(-1, 3)
    aim = (aim / np.linalg.norm(aim, axis=1, keepdims=True)).astype(np.float32)
    return np.broadcast_to(cam.position(1), aim.shape).astype(np.float32), aim


def surface(cam, roughness=0.3, metallic=0.0):
    """The G-buffer of the ball."""
    shape, proxy = (cam.height, cam.width), mesh()
    hits, known = hits_of(proxy, *rays(cam))
    normal, z = np.zeros((shape[0] * shape[1], 3), np.float32), np.full(shape[0] * shape[1], 1e10, np.float32)
    normal[known] = smooth_normals(proxy, hits.face, hits.weights())
    z[known] = cam.project(hits.point, 1)[:, 2]
    full, solid = np.ones(shape, np.float32), (proxy.first_hits(*rays(cam)) != OPEN).reshape(shape)
    opacity = solid.astype(np.float32)
    return Surface(normal.reshape(*shape, 3), z.reshape(shape), opacity, roughness * full, metallic * full, cam, 1)


def relit(seen, base=BASE):
    """The subject of a delivered view; its picture shows a diffuse radiance of 0.25."""
    shape = np.asarray(seen.opacity).shape
    return RelitSubject(seen, np.broadcast_to(base, (*shape, 3)), np.full((*shape, 3), 0.25, np.float32), mesh())


def ground(color=0.5, roughness=0.8, metallic=0.0):
    disc = Ground(0.0, (0.0, 0.0), 0.5, 20.0)
    return Surroundings(ProxyScene.from_arrays(*disc.mesh()), material(color, roughness, metallic), disc.height)
