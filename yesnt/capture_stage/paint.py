"""Painted surfaces as data: what colour, roughness and metallic lie where, in the rest pose's coordinates.

A coat is a stack of layers, the last on top. Blender builds shader nodes from it (`inside_blender/coats.py`); the
thickness of cloth and plates is applied here, to the rest mesh, by the same rules of place.
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
    """A place: where a field lies in an interval."""

    field: str
    low: float = -FAR
    high: float = FAR


@dataclass(frozen=True)
class Layer:
    """One material and where it lies.

    Attributes:
        name: for readers.
        where: all must hold; empty is everywhere.
        pattern: "plain", "noise", "stripes", "plaid", "checks", "spots" or "brushed".
        colors: the two ends of the pattern, linear Rec.709.
        scale: pattern repetitions a metre.
        roughness: the range that fine noise spreads over, Disney r.
        metallic: 0 or 1.
        thickness: metres that the surface is lifted by.
        softness: over which the lift fades at the border, in the fields' unit.
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


Coat = tuple[Layer, ...]


def coat_to_json(coat: Coat) -> list[dict[str, Any]]:
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
        for layer in coat
    ]


def fields_of(coat: Coat) -> tuple[str, ...]:
    """Names of the fields that a coat asks for, sorted."""
    return tuple(sorted({place.field for layer in coat for place in layer.where}))


def coverage(layer: Layer, fields: Fields) -> NDArray[np.float64]:
    """How surely a vertex lies in a layer: 0 outside, 1 beyond `softness` inside its borders; [V]."""
    inside = np.ones_like(np.asarray(fields["z"], dtype=np.float64))
    for place in layer.where:
        depth = np.minimum(fields[place.field] - place.low, place.high - fields[place.field])
        inside = np.minimum(inside, np.clip(depth / layer.softness, 0, 1))
    return inside


def lift(coat: Coat, fields: Fields) -> NDArray[np.float64]:
    """Height of the coat above the bare surface: the topmost layer decides where it lies; [V] metres."""
    height = np.zeros_like(np.asarray(fields["z"], dtype=np.float64))
    for layer in coat:
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
