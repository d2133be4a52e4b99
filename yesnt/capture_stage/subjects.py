"""Subjects of the capture stage: humans, painted shapes and fetched models, each as plain data for Blender."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from yesnt.capture_stage import costume, garments, hair, motions, shape_materials, shapes
from yesnt.capture_stage.assets import fetch
from yesnt.capture_stage.material_layers import Layers, fields_of, layers_to_json, vertex_normals
from yesnt.capture_stage.pose import Body, skin
from yesnt.capture_stage.tools import Tools, run_anny
from yesnt.io.durable import durable_path


@dataclass(frozen=True)
class Human:
    """A person of the parametric model, dressed and moving.

    Attributes:
        phenotype: anny's shape numbers, each 0..1.
        costume: name of a function of `garments`.
        motion: name of a function of `motions`.
        height: metres that the camera's picture shows from top to bottom.
        middle: height of the picture's middle above the ground, metres.
    """

    phenotype: tuple[tuple[str, float], ...]
    costume: str
    motion: str
    height: float = 2.1
    middle: float = 0.93

    def material_layers(self) -> Layers:
        """Skin and garments, the outermost last."""
        layers: Layers = getattr(garments, self.costume)()
        return layers


@dataclass(frozen=True)
class Variant(Human):
    """A person with an effect that relighting does not model.

    Attributes:
        subsurface: weight of subsurface scattering in bare skin, 0 to 1.
        strands: number of hairs on the head.
    """

    subsurface: float = 0.0
    strands: int = 0


@dataclass(frozen=True)
class Shape:
    """A surface of `shapes` with the material layers of a function of `shape_materials`."""

    build: str
    material: str
    height: float = 1.25
    middle: float = 0.5

    def material_layers(self) -> Layers:
        """Its materials, the outermost last."""
        layers: Layers = getattr(shape_materials, self.material)()
        return layers


@dataclass(frozen=True)
class Model:
    """A fetched glTF file with its own textures.

    Attributes:
        asset: name in the manifest.
        size: metres, the diameter of the ball that holds it after scaling.
        turn: Euler angles in radians, about x, y, z in turn.
        action: name of the animation that plays, None: none.
        roughness: a range that replaces the file's, as a mottle.
        smooth: rounds a model that was made of flat facets.
        height: as for `Human`.
        middle: as for `Human`.
    """

    asset: str
    size: float = 1.0
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    action: str | None = None
    roughness: tuple[float, float] | None = None
    smooth: bool = False
    height: float = 1.25
    middle: float = 0.5


Subject = Human | Shape | Model


def _person(**phenotype: float) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(phenotype.items()))


_WALKER = _person(gender=0.35, age=0.62, muscle=0.62, weight=0.42, height=0.55, proportions=0.8)
_BOXER = _person(gender=0.0, age=0.66, muscle=0.9, weight=0.6, height=0.6, proportions=0.7)
_DANCER = _person(gender=1.0, age=0.6, muscle=0.5, weight=0.35, height=0.45, proportions=0.9)
_ELDER = _person(gender=0.1, age=0.95, muscle=0.35, weight=0.75, height=0.5, proportions=0.4)

SUBJECTS: Mapping[str, Subject] = MappingProxyType({
    "walk": Human(_WALKER, "explorer", "walk_and_sweep"),
    "boxer": Human(_BOXER, "athlete", "box", height=2.35, middle=0.98),
    "dancer": Human(_DANCER, "performer", "turn_and_wave", height=2.3, middle=1.0),
    "fox": Model("fox", 1.25, (0.0, 0.0, -0.55), "Run", (0.4, 0.75), True, height=1.8, middle=0.36),
    "fox_still": Model("fox", 1.2, (0.0, 0.0, -0.7), "Survey", (0.6, 1.0), True, height=1.25, middle=0.36),
    "athlete": Human(_BOXER, "athlete", "guard", height=2.35, middle=0.98),
    "bust": Human(_BOXER, "athlete", "guard", height=0.85, middle=1.5),
    "bust+skin": Variant(_BOXER, "athlete", "guard", height=0.85, middle=1.5, subsurface=1.0),
    "bust+hair": Variant(_BOXER, "athlete", "guard", height=0.85, middle=1.5, strands=9000),
    "courtier": Human(_ELDER, "courtier", "greet", height=2.2),
    "controller_touch": Model("oculus-touch", 1.3, (0.6, 0.0, 0.7)),
    "controller_index": Model("valve-index", 1.3, (0.5, 0.0, -0.6)),
    "controller_reverb": Model("hp-mixed-reality", 1.4, (0.6, 0.0, 0.4)),
    "controller_vive": Model("htc-vive", 1.4, (0.8, 0.0, 2.6)),
    "drape": Shape("drape", "brocade", height=1.55, middle=0.46),
    "knot": Shape("knot", "worn_metal", middle=0.5),
    "vase": Shape("vase", "glaze", height=1.4, middle=0.5),
})  # fmt: skip
"""Every subject by name; `walk` is the embedded shot and stands in no set that is evaluated."""


def is_still(name: str) -> bool:
    """Whether a subject looks the same at every moment."""
    subject = SUBJECTS[name]
    return isinstance(subject, Shape) or (isinstance(subject, Model) and subject.action is None)


_KEY_NAMES = {"costume": "coat", "material": "coat", "subsurface": "flesh"}
"""Names of fields in the keys of render jobs: pictures that were rendered before the fields were renamed stay valid."""


def describe(name: str) -> dict[str, Any]:
    """Everything that decides what a subject looks like, as plain data for the keys of render jobs."""
    subject = SUBJECTS[name]
    fields = {_KEY_NAMES.get(field, field): value for field, value in subject.__dict__.items()}
    out: dict[str, Any] = {"kind": type(subject).__name__, **fields}
    if not isinstance(subject, Model):
        out["layers"] = layers_to_json(subject.material_layers())
    return out


def prepare(name: str, seconds: Sequence[float], tools: Tools, work: Path) -> dict[str, Any]:
    """Fetches or builds a subject; returns the description that `inside_blender/subjects.py` reads.

    Args:
        name: key of `SUBJECTS`.
        seconds: moments of the motion, one mesh each.
        tools: anny, and the cache of fetched files.
        work: folder for the arrays that Blender reads.
    """
    subject = SUBJECTS[name]
    if isinstance(subject, Model):
        path = fetch(subject.asset, Path(tools.cache))
        return {
            "kind": "gltf", "path": str(path), "size": subject.size, "turn": list(subject.turn),
            "action": subject.action, "roughness": subject.roughness, "smooth": subject.smooth,
            "hang": None if subject.action else subject.middle,
        }  # fmt: skip
    layers = subject.material_layers()
    archive = work / "subject.npz"
    if isinstance(subject, Human):
        arrays = _human_arrays(subject, layers, seconds, tools, work)
    else:
        arrays = _shape_arrays(subject, layers)
    with durable_path(archive) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)
    made = {"kind": "mesh", "archive": str(archive), "layers": layers_to_json(layers), "subdivision": 1}
    return {**made, "subsurface": subject.subsurface} if isinstance(subject, Variant) else made


def _human_arrays(human: Human, layers: Layers, seconds: Sequence[float], tools: Tools, work: Path) -> dict[str, Any]:
    body = Body.open(_rest_body(human, tools, work))
    dressed = costume.dress(body, layers)
    motion: motions.Motion = getattr(motions, human.motion)
    posed = np.stack([skin(body, motion(body, moment), dressed.vertices) for moment in seconds])
    arrays = _arrays(posed, body.faces, dressed.fields, layers)
    if isinstance(human, Variant) and human.strands:
        normals = vertex_normals(posed[0], body.faces)
        arrays["strands"] = hair.grow(posed[0], body.faces, normals, dressed.fields, human.strands)
    return arrays


def _shape_arrays(shape: Shape, layers: Layers) -> dict[str, Any]:
    vertices, faces, fields = getattr(shapes, shape.build)()
    return _arrays(vertices[None], faces, fields, layers)


def _arrays(posed: Any, faces: Any, fields: Mapping[str, Any], layers: Layers) -> dict[str, Any]:
    rest = np.stack([fields[axis] for axis in "xyz"], axis=-1).astype(np.float32)
    asked = {f"field_{name}": fields[name].astype(np.float32) for name in fields_of(layers)}
    return {"vertices": posed.astype(np.float32), "faces": faces, "rest": rest, **asked}


def _rest_body(human: Human, tools: Tools, work: Path) -> Path:
    key = hashlib.sha256(json.dumps(human.phenotype).encode()).hexdigest()[:16]
    path = Path(tools.cache) / "bodies" / f"{key}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        run_anny(tools, [{"out": str(path), "phenotype": dict(human.phenotype)}], work)
    return path
