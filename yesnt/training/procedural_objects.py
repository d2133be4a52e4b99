"""Renderings of procedural objects: a random solid in zones of material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from yesnt.capture_stage.cameras import look_at
from yesnt.capture_stage.material_layers import vertex_normals
from yesnt.core.camera import Camera
from yesnt.training.solids import SOLIDS, Builder, Solid, device, drapery, tube, vessel
from yesnt.training.subject_render import Subject, View, render_subject
from yesnt.training.synthetic.materials import MATERIAL, MaterialStyle, draw_class, paint
from yesnt.training.synthetic.render import Rendering

Float64 = NDArray[np.float64]

SIDE = 256
"""Rows and columns of an image."""

_STYLE = MaterialStyle(cloth_print=0.4, borrowed_colour=0.3, solid_print=0.4)
_METALS = ("brushed metal", "polished metal", "polished metal", "worn metal")
_CLOTH = ("woven",) * 4 + ("knit",) * 2 + ("denim", "satin", "satin", "leather")
_MATERIALS_BY_SOLID: dict[Builder, tuple[str, ...]] = {
    vessel: ("ceramic",) * 8 + _METALS + ("wood", "plastic", "moulded plastic", "stone"),
    tube: _METALS * 2 + ("rubber", "plastic", "wood", "leather", "ceramic", "moulded plastic"),
    device: ("plastic",) * 3 + ("moulded plastic",) * 4 + ("rubber",) * 2 + _METALS,
    drapery: _CLOTH,
}
"""Material classes of each solid, as often as they are listed: shape and material are correlated, as in reality."""

_FURTHER_MATERIALS: dict[Builder, tuple[str, ...]] = {drapery: (*_CLOTH, "brushed metal", "polished metal")}
"""Material classes of the other zones, where they differ from those of the main zone."""


@dataclass(frozen=True)
class ProceduralObject:
    """A solid with materials.

    Attributes:
        solid: surface.
        edges: ascending upper bounds of the zones on `solid.along`.
        zones: [zones] index of each zone's material.
        materials: [n] record array of `MATERIAL`.
    """

    solid: Solid
    edges: Float64
    zones: NDArray[np.int32]
    materials: NDArray[np.void]


def draw_object(rng: np.random.Generator) -> ProceduralObject:
    """Draws a solid, its zones and their materials."""
    build = SOLIDS[int(rng.integers(len(SOLIDS)))]
    solid = build(rng)
    likely = _MATERIALS_BY_SOLID[build]
    main = str(rng.choice(likely)) if rng.random() < 0.9 else draw_class(rng)
    further = _FURTHER_MATERIALS.get(build, likely)
    names = [main, *(str(rng.choice([main, *further])) for _ in range(int(rng.integers(0, 4))))]
    materials = np.array([paint(rng, name, _STYLE) for name in names], dtype=MATERIAL)
    parts = int(solid.along.max()) + 1
    inner = [n + np.sort(rng.random(int(rng.integers(0, 5 if parts == 1 else 2)))) for n in range(parts)]
    edges = np.sort(np.concatenate([np.arange(1, parts + 1), *inner]))
    # Every other zone is of the main material, so that it is the one that is seen most.
    zones = np.where(rng.random(len(edges)) < 0.5, 0, rng.integers(0, len(names), len(edges))).astype(np.int32)
    return ProceduralObject(solid, edges, zones, materials)


def render_object(rng: np.random.Generator, drawn: ProceduralObject) -> Rendering:
    """Renders an object with a random camera and light; it covers a third to all of the image.

    Args:
        rng: source of every choice.
        drawn: object with materials.

    Returns:
        Image of SIDE x SIDE pixels with ground truth.
    """
    metres = 0.3
    turn = look_at(np.zeros(3), rng.standard_normal(3) + 1e-3)[:3, :3] if rng.random() < 0.5 else np.eye(3)
    vertices = drawn.solid.vertices @ turn.T * metres
    middle = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - middle, axis=1).max())
    camera = _draw_camera(rng, middle, radius)
    pixels = SIDE / 2 / radius  # roughly, of a metre
    faces = drawn.solid.faces
    subject = Subject(
        vertices, faces, vertex_normals(vertices, faces), drawn.solid.uv * metres * pixels * rng.uniform(0.7, 1.4),
        partial(_zone, drawn), drawn.materials,
    )  # fmt: skip
    return render_subject(rng, subject, camera)


def _draw_camera(rng: np.random.Generator, middle: Float64, radius: float) -> Camera:
    """Camera slightly above the object, which is shown whole or cropped; focal lengths like 35 to 85 mm."""
    focal = SIDE * rng.uniform(1.0, 2.6)
    share = rng.uniform(0.35, 1.25)  # radius over half of the image
    away = radius * focal / (share * SIDE / 2)
    angle, slope = rng.uniform(-np.pi, np.pi), np.radians(np.clip(rng.normal(15, 15), -30, 60))
    target = middle + rng.normal(0, 0.12, 3) * radius
    offset = np.array([np.cos(slope) * np.sin(angle), -np.cos(slope) * np.cos(angle), np.sin(slope)])
    pose = look_at(target + max(away, 1.3 * radius) * offset, target)
    return Camera(SIDE, SIDE, focal, focal, SIDE / 2, SIDE / 2, {0: pose})


def _zone(drawn: ProceduralObject, view: View) -> NDArray[np.int32]:
    """[H, W] index of the material at each pixel, -1 outside the object."""
    along = view.interpolate(drawn.solid.along)
    zone = np.minimum(np.searchsorted(drawn.edges, along, side="right"), len(drawn.edges) - 1)
    return np.where(view.seen, drawn.zones[zone], -1).astype(np.int32)
