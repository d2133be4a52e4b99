"""Renderings of synthetic people: a dressed, posed body in front of a random camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.capture_stage.cameras import look_at
from yesnt.capture_stage.costume import Dressed, dress
from yesnt.capture_stage.material_layers import vertex_normals
from yesnt.capture_stage.pose import Body, skin
from yesnt.core.camera import Camera
from yesnt.training.bodies import draw_pose
from yesnt.training.garments import Garments, draw_garments
from yesnt.training.subject_render import Subject, View, render_subject
from yesnt.training.synthetic.materials import DEFAULT_STYLE, MaterialStyle
from yesnt.training.synthetic.render import Rendering

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

HEIGHT, WIDTH = 320, 224
"""Rows and columns of an image."""

_REST_HEIGHT = 1.78
"""Height in metres of the rest pose in which the fields of the costume are measured."""


@dataclass(frozen=True)
class Person:
    """A dressed person.

    Attributes:
        body: body without garments.
        dressed: vertices with the thickness of the garments, and fields of the costume.
        garments: garments and their materials.
    """

    body: Body
    dressed: Dressed
    garments: Garments


def draw_person(rng: np.random.Generator, body: Body, style: MaterialStyle = DEFAULT_STYLE) -> Person:
    """Draws garments for a body and dresses it.

    Args:
        rng: source of every choice.
        body: body in rest pose.
        style: colour and print statistics of the materials.
    """
    garments = draw_garments(rng, style)
    return Person(body, dress(body, garments.frozen_layers(), folds=rng.uniform(0, 0.007)), garments)


@lru_cache(maxsize=4)
def open_body(path: Path) -> Body:
    """Reads a rest body from its file."""
    return Body.open(path)


def render_person(rng: np.random.Generator, person: Person) -> Rendering:
    """Renders a person with a random pose, camera and light.

    Args:
        rng: source of every choice.
        person: dressed person.

    Returns:
        Image of HEIGHT x WIDTH pixels with ground truth.
    """
    vertices = skin(person.body, draw_pose(rng, person.body), person.dressed.vertices)
    camera = _draw_camera(rng, vertices)
    quads = person.body.faces
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    subject = Subject(
        vertices, faces, vertex_normals(vertices, quads), _surface_coordinates(rng, person),
        partial(_garment, person), person.garments.materials(),
    )  # fmt: skip
    return render_subject(rng, subject, camera)


def _draw_camera(rng: np.random.Generator, vertices: Float64) -> Camera:
    """Camera that shows the whole figure or a part of it, with a figure of 200 to 700 pixels height."""
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


def _garment(person: Person, view: View) -> NDArray[np.int32]:
    """[H, W] index of the topmost garment at each pixel, -1 outside the person."""
    seen = view.seen
    asked = {place.field for layer in person.garments.layers for place in layer.where}
    fields = {name: view.interpolate(person.dressed.fields[name]) for name in asked}
    number = np.where(seen, 0, -1).astype(np.int32)
    for index, layer in enumerate(person.garments.layers):
        inside = seen.copy()
        for place in layer.where:
            inside &= (fields[place.field] > place.low) & (fields[place.field] < place.high)
        number[inside] = index
    return number


def _surface_coordinates(rng: np.random.Generator, person: Person) -> Float64:
    """[V, 2] texture coordinates: the rest pose projected to a plane, in pixels of a body about 330 pixels tall."""
    fields = person.dressed.fields
    lean = rng.normal(0, 0.5, 2)
    across, up = fields["x"] + lean[0] * fields["y"], fields["z"] + lean[1] * fields["y"]
    return np.stack([across, -up], -1) * (330 / _REST_HEIGHT)
