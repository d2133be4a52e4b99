"""Renders a painted triangle mesh for training: primary rays, coverage, and the project's own relighting."""

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
"""Relighting settings of training images; their light is nearly even, so coarser light sampling hardly changes them."""


@dataclass(frozen=True)
class View:
    """First hits of the rays through the pixel centres.

    Attributes:
        corners: [H, W, 3] vertex indices of the triangle.
        weights: [H, W, 3] barycentric weights, 0 where the ray hits nothing.
        z: [H, W] planar depth in metres, 1e10 where the ray hits nothing.
    """

    corners: NDArray[np.int32]
    weights: Float32
    z: Float32

    @classmethod
    def look(cls, camera: Camera, scene: ProxyScene, faces: NDArray[np.int32]) -> View:
        """Casts a ray through the centre of every pixel of frame 0 of a camera.

        Args:
            camera: camera with a pose for frame 0.
            scene: ray-tracing scene of the mesh.
            faces: [F, 3] vertex indices of the mesh.
        """
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
        """[H, W] whether the ray hits the mesh."""
        return self.z < 1e9

    def interpolate(self, values: Float64) -> Float32:
        """Interpolates values per vertex [V, ...] to pixels [H, W, ...]."""
        taken = np.asarray(values, dtype=np.float32)[self.corners]
        return np.einsum("hwk,hwk...->hw...", self.weights, taken)


@dataclass(frozen=True)
class Subject:
    """A mesh with materials.

    Attributes:
        vertices: [V, 3] world space, metres.
        faces: [F, 3] triangles, counter-clockwise seen from outside.
        normals: [V, 3] unit vectors.
        uv: [V, 2] texture coordinates of about one pixel per unit.
        number: function from a view to the index of the material at each pixel [H, W], -1 outside the subject.
        materials: [n] record array of `MATERIAL`.
    """

    vertices: Float64
    faces: NDArray[np.int32]
    normals: Float64
    uv: Float64
    number: Callable[[View], NDArray[np.int32]]
    materials: NDArray[np.void]


def render_subject(rng: np.random.Generator, subject: Subject, camera: Camera) -> Rendering:
    """Paints what frame 0 of a camera sees of a subject, and shades it under a random capture light.

    Args:
        rng: source of the light.
        subject: mesh with materials.
        camera: camera with a pose for frame 0.

    Returns:
        Image with ground truth.
    """
    scene = ProxyScene.from_arrays(subject.vertices, subject.faces)
    view = View.look(camera, scene, subject.faces)
    number = subject.number(view)
    turn = camera.poses[0][:3, :3] @ np.diag([1.0, 1.0, -1.0])  # image axes (x right, y down, z to the camera)
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
    """First hits of rays [R, 3] from the camera position; `tfar` is the distance in metres."""
    unit = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    eye = np.broadcast_to(camera.position(0).astype(np.float32), unit.shape)
    return scene.trace(eye, unit)


def _coverage(camera: Camera, scene: ProxyScene, view: View) -> Float32:
    """[H, W] fraction of four rays per pixel that hit the subject; at least one where the centre ray does."""
    rays = camera.rays(0)
    right, down = rays[0, 1] - rays[0, 0], rays[1, 0] - rays[0, 0]
    total = np.zeros(view.z.shape)
    for x, y in ((-0.25, -0.1), (0.1, -0.25), (0.25, 0.1), (-0.1, 0.25)):
        aside = (rays + x * right + y * down).reshape(-1, 3)
        total += (_cast(camera, scene, aside)["primID"] >= 0).reshape(total.shape)
    return np.where(view.seen, np.maximum(total, 1) / 4, 0).astype(np.float32)


def _lit(rng: np.random.Generator, surface: Surface, base: Float32, scene: ProxyScene) -> Float32:
    """Radiance [H, W, 3] under a random capture light."""
    env = EnvMap.from_array(draw_radiance(rng)).turned((rng.uniform(-180, 180), 0.0, 0.0))
    pixels = gather_pixels(surface)
    occluders = find_occluders(surface, pixels, scene, _SETTINGS)
    colour = base.reshape(-1, 3)[pixels.index]
    return shade_pixels(colour, pixels, occluders, prepare_relight(env, _SETTINGS), _SETTINGS).radiance


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
