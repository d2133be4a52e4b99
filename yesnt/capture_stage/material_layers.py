"""Material layers as data: where on a surface which colour, roughness and metallic lie, in rest-pose coordinates.

A surface has a tuple of layers, the last on top. Blender builds shader nodes from them (`inside_blender/materials.py`);
the thickness of cloth and plates displaces the rest mesh here, by the same intervals of the same fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Color = tuple[float, float, float]
Fields = Mapping[str, NDArray[np.floating]]
"""Per vertex numbers by name, [V]; every mesh has at least `x`, `y`, `z` of its rest pose in metres."""

FAR = 1e6


@dataclass(frozen=True)
class Between:
    """The part of a surface where a per-vertex field lies in an interval."""

    field: str
    low: float = -FAR
    high: float = FAR


@dataclass(frozen=True)
class Layer:
    """One material and the part of the surface that it covers.

    Attributes:
        name: not used in rendering, except that skin is recognised by it.
        where: intervals that must all hold; empty is everywhere.
        pattern: "plain", "noise", "stripes", "plaid", "checks", "spots" or "brushed".
        colors: the two ends of the pattern, linear Rec.709.
        scale: pattern repetitions a metre.
        roughness: the range that fine noise spreads over, Disney r.
        metallic: 0 or 1.
        thickness: displacement of the surface in metres.
        softness: distance over which the displacement fades at the border, in the fields' unit.
    """

    name: str
    where: tuple[Between, ...]
    pattern: str
    colors: tuple[Color, Color]
    scale: float
    roughness: tuple[float, float]
    metallic: float = 0.0
    thickness: float = 0.0
    softness: float = 0.015


Layers = tuple[Layer, ...]


def layers_to_json(layers: Layers) -> list[dict[str, Any]]:
    """Plain data for the script inside Blender."""
    return [
        {
            "name": layer.name,
            "where": [{"field": b.field, "low": b.low, "high": b.high} for b in layer.where],
            "pattern": layer.pattern,
            "colors": [list(c) for c in layer.colors],
            "scale": layer.scale,
            "roughness": list(layer.roughness),
            "metallic": layer.metallic,
        }
        for layer in layers
    ]


def fields_of(layers: Layers) -> tuple[str, ...]:
    """Names of the fields that the layers use, sorted."""
    return tuple(sorted({place.field for layer in layers for place in layer.where}))


def coverage(layer: Layer, fields: Fields) -> NDArray[np.float64]:
    """Coverage of the vertices by a layer, [V]: 0 outside, 1 from `softness` inside its borders, linear between."""
    inside = np.ones_like(np.asarray(fields["z"], dtype=np.float64))
    for place in layer.where:
        depth = np.minimum(fields[place.field] - place.low, place.high - fields[place.field])
        inside = np.minimum(inside, np.clip(depth / layer.softness, 0, 1))
    return inside


def displacement(layers: Layers, fields: Fields) -> NDArray[np.float64]:
    """Height of the layers above the bare surface, [V] metres: the topmost layer that has a thickness decides."""
    height = np.zeros_like(np.asarray(fields["z"], dtype=np.float64))
    for layer in layers:
        share = coverage(layer, fields)
        height = height + share * (layer.thickness - height) if layer.thickness else height
    return height


def vertex_normals(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Area-weighted unit normals, [V, 3], of triangles or quads wound counter-clockwise seen from outside."""
    first = vertices[faces[:, 2]] - vertices[faces[:, 0]]
    second = vertices[faces[:, -1]] - vertices[faces[:, 1]]
    normals = np.zeros((len(vertices), 3))
    for corner in range(faces.shape[1]):
        np.add.at(normals, faces[:, corner], np.cross(first, second))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
