"""Pictures of people for training: a dressed, posed body, seen by a camera, lit by the project's own relighting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.camera import Camera
from yesnt.relight import EnvMap, ProxyScene, RelightSettings, Surface, prepare_relight
from yesnt.relight.frame import shade_pixels
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import gather_pixels
from yesnt.stage.cameras import look_at
from yesnt.stage.paint import vertex_normals
from yesnt.stage.pose import Body, skin
from yesnt.stage.wardrobe import Dressed, dress
from yesnt.training.bodies import draw_pose
from yesnt.training.outfits import Outfit, draw_outfit
from yesnt.training.synthetic.light import draw_radiance
from yesnt.training.synthetic.materials import EVERYDAY, Habits
from yesnt.training.synthetic.render import Rendering, material_class, paint_surface

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

HEIGHT, WIDTH = 320, 224
"""Pixels of a picture."""

_RESTING = 1.78
"""Metres of the body in whose measures the wardrobe's fields are given."""

_SETTINGS = RelightSettings.from_quality("draft", texels=256, rows=64, clusters=40, bounce=1, edges=False)
"""What a training plate is lit with: under a nearly even light coarser is hardly different."""


@dataclass(frozen=True)
class Person:
    """Somebody dressed.

    Attributes:
        body: bare.
        dressed: with the clothes' thickness.
        outfit: what is worn.
    """

    body: Body
    dressed: Dressed
    outfit: Outfit


def draw_person(rng: np.random.Generator, body: Body, habits: Habits = EVERYDAY) -> Person:
    """Dresses a body."""
    outfit = draw_outfit(rng, habits)
    return Person(body, dress(body, outfit.coat(), folds=rng.uniform(0, 0.007)), outfit)


@lru_cache(maxsize=4)
def open_body(path: Path) -> Body:
    """A rest body from its file."""
    return Body.open(path)


def photograph(rng: np.random.Generator, person: Person) -> Rendering:
    """Poses the person, aims a camera, lights and shades."""
    vertices = skin(person.body, draw_pose(rng, person.body), person.dressed.vertices)
    camera = _draw_camera(rng, vertices)
    quads = person.body.faces
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    scene = ProxyScene.from_arrays(vertices, faces)
    view = _View.look(camera, scene, faces)
    number = _garment(person, view)
    uv = view.interpolate(_surface_coordinates(rng, person))
    normal = view.interpolate(vertex_normals(vertices, quads))
    turn = camera.poses[0][:3, :3] @ np.diag([1.0, 1.0, -1.0])  # picture axes (x right, y down, z to the camera)
    painted = paint_surface(_unit(normal @ turn).astype(np.float32), uv, number, person.outfit.materials())
    planes = painted.transpose(1, 2, 0)
    surface = Surface(
        planes[..., 5:] @ turn.T.astype(np.float32), view.z, (number >= 0).astype(np.float32), painted[3], painted[4],
        camera,
    )  # fmt: skip
    radiance = _lit(rng, surface, planes[..., :3], scene)
    covered = _coverage(camera, scene, view)
    return Rendering(
        (radiance * covered[..., None]).transpose(2, 0, 1).astype(np.float32),
        covered, painted[3:5], material_class(number, person.outfit.materials()),
    )  # fmt: skip


def _draw_camera(rng: np.random.Generator, vertices: Float64) -> Camera:
    """The whole figure, or a part of one: 200 to 700 pixels tall."""
    tall = float(vertices[:, 2].max())
    pixels = np.exp(rng.uniform(np.log(200), np.log(420 if rng.random() < 0.75 else 700)))
    shown = tall * HEIGHT / pixels
    middle = tall / 2 if shown > tall else rng.uniform(shown / 2.2, tall - shown / 2.2)
    focal = 1.45 * HEIGHT
    angle, rise = np.radians(rng.uniform(-180, 180) if rng.random() < 0.35 else rng.normal(0, 35)), rng.normal(6, 8)
    slope = np.radians(np.clip(rise, -20, 35))
    target = np.array([rng.normal(0, 0.03), rng.normal(0, 0.03), middle])
    offset = np.array([np.cos(slope) * np.sin(angle), -np.cos(slope) * np.cos(angle), np.sin(slope)])
    pose = look_at(target + focal * shown / HEIGHT * offset, target)
    return Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, {0: pose})


@dataclass(frozen=True)
class _View:
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
    def look(cls, camera: Camera, scene: ProxyScene, faces: NDArray[np.int32]) -> _View:
        rays = camera.rays(0).reshape(-1, 3)
        found = _cast(camera, scene, rays)
        met = found["primID"] >= 0
        second, third = found["u"], found["v"]
        weights = np.stack([1 - second - third, second, third], -1) * met[:, None]
        z = np.where(met, found["tfar"] / np.linalg.norm(rays, axis=1), 1e10)
        size = (camera.height, camera.width)
        corners = faces[np.maximum(found["primID"], 0)]
        return cls(corners.reshape(*size, 3), weights.reshape(*size, 3).astype(np.float32), z.reshape(size))

    def interpolate(self, values: Float64) -> Float32:
        """Per vertex [V, ...] to per pixel [H, W, ...]."""
        taken = np.asarray(values, dtype=np.float32)[self.corners]
        return np.einsum("hwk,hwk...->hw...", self.weights, taken)


def _cast(camera: Camera, scene: ProxyScene, rays: NDArray[np.floating]) -> Any:
    """First hits of rays [R, 3] from the eye; `tfar` is a distance in metres."""
    unit = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    eye = np.broadcast_to(camera.position(0).astype(np.float32), unit.shape)
    return scene.trace(eye, unit)


def _coverage(camera: Camera, scene: ProxyScene, view: _View) -> Float32:
    """[H, W] share of four rays a pixel that meet the body; at least one where the middle does."""
    rays = camera.rays(0)
    right, down = rays[0, 1] - rays[0, 0], rays[1, 0] - rays[0, 0]
    total = np.zeros(view.z.shape)
    for x, y in ((-0.25, -0.1), (0.1, -0.25), (0.25, 0.1), (-0.1, 0.25)):
        aside = (rays + x * right + y * down).reshape(-1, 3)
        total += (_cast(camera, scene, aside)["primID"] >= 0).reshape(total.shape)
    return np.where(view.z < 1e9, np.maximum(total, 1) / 4, 0).astype(np.float32)


def _garment(person: Person, view: _View) -> NDArray[np.int32]:
    """[H, W] number of the topmost garment at each pixel, -1 where nobody is."""
    seen = view.z < 1e9
    asked = {place.field for layer in person.outfit.layers for place in layer.where}
    fields = {name: view.interpolate(person.dressed.fields[name]) for name in asked}
    number = np.where(seen, 0, -1).astype(np.int32)
    for index, layer in enumerate(person.outfit.layers):
        inside = seen.copy()
        for place in layer.where:
            inside &= (fields[place.field] > place.low) & (fields[place.field] < place.high)
        number[inside] = index
    return number


def _surface_coordinates(rng: np.random.Generator, person: Person) -> Float64:
    """[V, 2] paint coordinates: the rest pose flattened, in pixels of a body about 330 pixels tall."""
    fields = person.dressed.fields
    lean = rng.normal(0, 0.5, 2)
    across, up = fields["x"] + lean[0] * fields["y"], fields["z"] + lean[1] * fields["y"]
    return np.stack([across, -up], -1) * (330 / _RESTING)


def _lit(rng: np.random.Generator, surface: Surface, base: Float32, scene: ProxyScene) -> Float32:
    """Radiance [H, W, 3] under a drawn capture light."""
    env = EnvMap.from_array(draw_radiance(rng)).turned((rng.uniform(-180, 180), 0.0, 0.0))
    pixels = gather_pixels(surface)
    occluders = find_occluders(surface, pixels, scene, _SETTINGS)
    colour = base.reshape(-1, 3)[pixels.index]
    return shade_pixels(colour, pixels, occluders, prepare_relight(env, _SETTINGS), _SETTINGS).radiance


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
