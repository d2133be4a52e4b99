"""Which pixels show the set: a ground plane or a mesh, seen by the shot's camera."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.surroundings import SetMaterial
from yesnt.scene.ground import Ground
from yesnt.scene.mesh_edges import OFF, EdgeMix, edge_mix, other_surface
from yesnt.scene.mesh_normals import CREASE, smooth_normals
from yesnt.scene.pixel_parts import PARTS, PixelParts
from yesnt.scene.set_scene import SetView

F32 = NDArray[np.float32]

SIDE = 4
"""A mesh covers a pixel as far as this many by this many rays meet it."""

_PLACES = tuple(((x + 0.5) / SIDE - 0.5, (y + 0.5) / SIDE - 0.5) for y in range(SIDE) for x in range(SIDE))

_GRAZING = 1e-4  # least slope of a ray that meets a plane: the next row would lie kilometres away
_BEHIND = 0.02  # metres by which a mesh must be in front of the subject to hide it: feet sink into a floor


class SetImage(NamedTuple):
    """The set in one frame.

    Attributes:
        view: its P pixels.
        cover: [P] share of the pixel that shows it, fading included.
        holdout: [H, W] share of the pixel in which it is in front of the subject.
        edges: pixels in which surfaces of a mesh meet; None: there are none.
    """

    view: SetView
    cover: F32
    holdout: F32
    edges: EdgeMix | None = None


def ground_image(ground: Ground, material: SetMaterial, camera: Camera, frame: int) -> SetImage:
    """A ground plane, seen from above; from below it is not there. It hides nothing of the subject."""
    rays, eye = camera.rays(frame), camera.position(frame)
    shape = (camera.height, camera.width)
    down = rays[..., 2].astype(np.float64)
    z = np.where(down < -_GRAZING, (ground.height - eye[2]) / np.minimum(down, -_GRAZING), -1)
    index = np.flatnonzero(z > 0)
    position = (eye + rays.reshape(-1, 3)[index] * z.reshape(-1)[index, None]).astype(np.float32)
    cover = ground.cover(position)
    index, position, cover = index[cover > 0], position[cover > 0], cover[cover > 0]
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), position.shape)
    view = _view(index, position, np.ascontiguousarray(normal), material, camera, frame)
    return SetImage(view, cover, np.zeros(shape, np.float32))


def mesh_image(mesh: ProxyScene, material: SetMaterial, camera: Camera, frame: int, z: F32) -> SetImage:
    """A mesh; `z` [H, W] is the subject's planar depth in metres, 0 where it is not.

    A pixel is shaded where the first of its rays that meets the mesh meets it, beginning with that through its middle.
    """
    shape, eye = (camera.height, camera.width), camera.position(frame).astype(np.float32)
    share, before, several = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    face, point = np.full(shape, OPEN, np.int32), np.zeros((*shape, 3), np.float32)
    for number, (across, down) in enumerate(((0.0, 0.0), *_PLACES)):
        rays = camera.windowed(across, down, camera.width, camera.height).rays(frame)
        length = np.linalg.norm(rays, axis=-1)
        unit = (rays / length[..., None]).reshape(-1, 3)
        met = mesh.trace(np.broadcast_to(eye, unit.shape).astype(np.float32), unit)
        found = met["primID"].reshape(shape)
        depth = np.where(found != OPEN, met["tfar"].reshape(shape) / length, np.inf)
        fresh = (face == OPEN) & (found != OPEN)
        face[fresh], point[fresh] = found[fresh], (eye + rays * np.where(fresh, depth, 0)[..., None])[fresh]
        apart = np.flatnonzero((found != face) & (found != OPEN) & (face != OPEN))
        faces = face.reshape(-1)[apart], found.reshape(-1)[apart].astype(np.int32)
        places = point.reshape(-1, 3)[apart], eye + (rays * depth[..., None]).reshape(-1, 3)[apart]
        several.reshape(-1)[apart[other_surface(mesh, eye, faces, places)]] = True
        if number:  # the ray through the middle would count twice
            share += found != OPEN
            before += (depth < z - _BEHIND) & (z > 0)
    index = np.flatnonzero((face != OPEN) & (share > 0))
    where, at = face.reshape(-1)[index], point.reshape(-1, 3)[index]
    view = _view(index, at, _normals(mesh, where, at, eye), material, camera, frame)
    view = replace(view, parts=_on_surface(view, mesh))
    edge, window = np.flatnonzero(several.reshape(-1)[index]), (camera.width, camera.height)
    through = [camera.windowed(*one, *window).rays(frame).reshape(-1, 3)[index[edge]] for one in _PLACES]
    mix = edge_mix(view.pixels, mesh, eye, edge, np.stack(through, axis=1))
    return SetImage(view, share.reshape(-1)[index] / np.float32(SIDE**2), before / np.float32(SIDE**2), mix)


def _view(
    index: NDArray[np.int64], position: F32, normal: F32, material: SetMaterial, camera: Camera, frame: int
) -> SetView:
    eye = camera.position(frame).astype(np.float32)
    aim = eye - position
    aim /= np.maximum(np.linalg.norm(aim, axis=1, keepdims=True), np.float32(1e-9))
    full = np.ones(len(index), np.float32)
    shape = (camera.height, camera.width)
    pixels = Pixels(index, shape, position, normal, aim, full * material.roughness, full * material.metallic)
    parts = [camera.windowed(*part, camera.width, camera.height).rays(frame).reshape(-1, 3)[index] for part in PARTS]
    return SetView(pixels, material.color, PixelParts(eye, np.stack(parts)))


def _on_surface(view: SetView, mesh: ProxyScene) -> PixelParts:
    """Parts whose rays meet a pixel's own surface; the others, which would lie inside a neighbour's, are its middle.

    At a crease the plane of one pixel goes on behind the surface of the next.
    """
    pixels, parts = view.pixels, view.parts
    every, rays = np.arange(len(pixels.index)), parts.rays.copy()
    start = np.broadcast_to(parts.eye, pixels.position.shape).astype(np.float32)
    for number in range(len(PARTS)):
        point, aim = parts.seen(pixels, number, every)
        far = np.linalg.norm(point - parts.eye, axis=1)
        met = mesh.trace(start, aim)
        turned = np.abs((mesh.normals[met["primID"].astype(np.int32)] * pixels.normal).sum(axis=1)) < CREASE
        off = turned | (np.abs(met["tfar"] - far) > OFF * far)
        rays[number][off] = (pixels.position - parts.eye)[off]
    return PixelParts(parts.eye, rays)


def _normals(mesh: ProxyScene, face: NDArray[np.int32], point: F32, eye: F32) -> F32:
    """Unit normals [P, 3] towards the eye: interpolated between vertices, but for creases."""
    a, b, c = (mesh.vertices[mesh.faces[face][:, k]] for k in range(3))
    u, v = _barycentric(point, a, b, c)
    mixed = smooth_normals(mesh, face, (1 - u - v, u, v))
    facing = ((eye - point) * mesh.normals[face]).sum(axis=1, keepdims=True) < 0
    return np.where(facing, -mixed, mixed).astype(np.float32)


def _barycentric(point: F32, a: F32, b: F32, c: F32) -> tuple[F32, F32]:
    """Weights [P] of corners b and c of points [P, 3] in triangles, in [0, 1]."""
    one, two, to = b - a, c - a, point - a
    d11, d12, d22 = (one * one).sum(1), (one * two).sum(1), (two * two).sum(1)
    e1, e2 = (to * one).sum(1), (to * two).sum(1)
    over = np.maximum(d11 * d22 - d12 * d12, 1e-20)
    u, v = (d22 * e1 - d12 * e2) / over, (d11 * e2 - d12 * e1) / over
    return np.clip(u, 0, 1), np.clip(v, 0, 1)
