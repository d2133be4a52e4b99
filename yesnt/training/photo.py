"""Photographs a painted, triangulated subject for training: camera rays, coverage, the project's own relighting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.relight import EnvMap, ProxyScene, RelightSettings, Surface, prepare_relight
from yesnt.relight.frame import shade_pixels
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import gather_pixels
from yesnt.training.synthetic.light import draw_radiance
from yesnt.training.synthetic.render import Rendering, material_class, paint_surface

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_SETTINGS = RelightSettings.from_quality("draft", texels=256, rows=64, clusters=40, bounce=1, edges=False)
"""What a training plate is lit with: under a nearly even light coarser is hardly different."""


@dataclass(frozen=True)
class View:
    """What every pixel's ray meets.

    Attributes:
        corners: [H, W, 3] vertices of the triangle.
        weights: [H, W, 3] barycentric, 0 where nothing is met.
        z: [H, W] planar depth in metres, 1e10 where nothing is met.
    """

    corners: NDArray[np.int32]
    weights: Float32
    z: Float32

    @classmethod
    def look(cls, camera: Camera, scene: ProxyScene, faces: NDArray[np.int32]) -> View:
        """Casts a ray through the middle of every pixel of the camera's frame 0."""
        rays = camera.rays(0).reshape(-1, 3)
        found = _cast(camera, scene, rays)
        met = found["primID"] >= 0
        second, third = found["u"], found["v"]
        weights = np.stack([1 - second - third, second, third], -1) * met[:, None]
        z = np.where(met, found["tfar"] / np.linalg.norm(rays, axis=1), 1e10)
        size = (camera.height, camera.width)
        corners = faces[np.maximum(found["primID"], 0)]
        return cls(corners.reshape(*size, 3), weights.reshape(*size, 3).astype(np.float32), z.reshape(size))

    @property
    def seen(self) -> NDArray[np.bool_]:
        """[H, W] where something is met."""
        return self.z < 1e9

    def interpolate(self, values: Float64) -> Float32:
        """Per vertex [V, ...] to per pixel [H, W, ...]."""
        taken = np.asarray(values, dtype=np.float32)[self.corners]
        return np.einsum("hwk,hwk...->hw...", self.weights, taken)


@dataclass(frozen=True)
class Subject:
    """What stands before the camera.

    Attributes:
        vertices: [V, 3] world metres.
        faces: [F, 3] triangles, counter-clockwise seen from outside.
        normals: [V, 3] unit.
        uv: [V, 2] paint coordinates, about a pixel a unit.
        number: the material's number at each pixel [H, W] of a view, -1 where nothing is.
        materials: [n] record array of `MATERIAL`.
    """

    vertices: Float64
    faces: NDArray[np.int32]
    normals: Float64
    uv: Float64
    number: Callable[[View], NDArray[np.int32]]
    materials: NDArray[np.void]


def render_subject(rng: np.random.Generator, subject: Subject, camera: Camera) -> Rendering:
    """Paints what frame 0 of a camera sees of the subject and lights it with a drawn capture light."""
    scene = ProxyScene.from_arrays(subject.vertices, subject.faces)
    view = View.look(camera, scene, subject.faces)
    number = subject.number(view)
    turn = camera.poses[0][:3, :3] @ np.diag([1.0, 1.0, -1.0])  # picture axes (x right, y down, z to the camera)
    normal = _unit(view.interpolate(subject.normals) @ turn).astype(np.float32)
    painted = paint_surface(normal, view.interpolate(subject.uv), number, subject.materials)
    planes = painted.transpose(1, 2, 0)
    surface = Surface(
        planes[..., 5:] @ turn.T.astype(np.float32), view.z, (number >= 0).astype(np.float32), painted[3], painted[4],
        camera,
    )  # fmt: skip
    radiance = _lit(rng, surface, planes[..., :3], scene)
    covered = _coverage(camera, scene, view)
    return Rendering(
        (radiance * covered[..., None]).transpose(2, 0, 1).astype(np.float32),
        covered, painted[3:5], material_class(number, subject.materials),
    )  # fmt: skip


def _cast(camera: Camera, scene: ProxyScene, rays: NDArray[np.floating]) -> Any:
    """First hits of rays [R, 3] from the eye; `tfar` is a distance in metres."""
    unit = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    eye = np.broadcast_to(camera.position(0).astype(np.float32), unit.shape)
    return scene.trace(eye, unit)


def _coverage(camera: Camera, scene: ProxyScene, view: View) -> Float32:
    """[H, W] share of four rays a pixel that meet the subject; at least one where the middle does."""
    rays = camera.rays(0)
    right, down = rays[0, 1] - rays[0, 0], rays[1, 0] - rays[0, 0]
    total = np.zeros(view.z.shape)
    for x, y in ((-0.25, -0.1), (0.1, -0.25), (0.25, 0.1), (-0.1, 0.25)):
        aside = (rays + x * right + y * down).reshape(-1, 3)
        total += (_cast(camera, scene, aside)["primID"] >= 0).reshape(total.shape)
    return np.where(view.seen, np.maximum(total, 1) / 4, 0).astype(np.float32)


def _lit(rng: np.random.Generator, surface: Surface, base: Float32, scene: ProxyScene) -> Float32:
    """Radiance [H, W, 3] under a drawn capture light."""
    env = EnvMap.from_array(draw_radiance(rng)).turned((rng.uniform(-180, 180), 0.0, 0.0))
    pixels = gather_pixels(surface)
    occluders = find_occluders(surface, pixels, scene, _SETTINGS)
    colour = base.reshape(-1, 3)[pixels.index]
    return shade_pixels(colour, pixels, occluders, prepare_relight(env, _SETTINGS), _SETTINGS).radiance


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
