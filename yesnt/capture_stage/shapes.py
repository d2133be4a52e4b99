"""Procedural surfaces: a drape, a knot, a vase. Vertices in metres, quads, and per-vertex fields for materials."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Built = tuple[Array, NDArray[np.int32], dict[str, Array]]
"""Vertices [V, 3], quads [F, 4] and per-vertex fields, of which `x`, `y`, `z` are the rest position."""


def knot(around: int = 260, across: int = 26) -> Built:
    """A (2, 3) torus knot as a tube of 7.5 cm radius; vertex fields `gilt` and `rust` are high on two parts."""
    t = np.arange(around) / around * 2 * np.pi
    ring = 2 + np.cos(3 * t)
    center = 0.155 * np.stack([ring * np.cos(2 * t), 1.15 * np.sin(3 * t), ring * np.sin(2 * t) / 1.3], -1)
    forward = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    side = np.cross(forward, np.gradient(forward, axis=0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    above = np.cross(side, forward)
    a = np.arange(across) / across * 2 * np.pi
    tube = side[:, None] * np.cos(a)[None, :, None] + above[:, None] * np.sin(a)[None, :, None]
    points = center[:, None] + 0.075 * tube
    points[..., 2] -= points[..., 2].min()
    near = {name: np.cos(t - 2 * np.pi * at) for name, at in (("gilt", 0.40), ("rust", 0.75))}
    fields = {name: np.broadcast_to(values[:, None], points.shape[:2]) for name, values in near.items()}
    return _grid(points, wrap_rows=True, wrap_columns=True, **fields)


def vase(rings: int = 140, across: int = 96) -> Built:
    """A turned vessel with a foot, a belly and an open neck, 1 m tall, walls 2 cm thick; field `inside` is 1 inside."""
    t = np.linspace(0, 1, rings)
    outer = (
        0.17
        + 0.15 * np.sin(np.pi * np.clip(t * 1.12, 0, 1)) ** 1.4
        - 0.05 * t
        + 0.06 * np.clip((t - 0.88) / 0.12, 0, 1) ** 2
    )
    outer = outer * (1 + 0.012 * np.sin(60 * t) * (t > 0.25) * (t < 0.7))
    profile = np.concatenate([
        [[1e-4, 0.0]], np.stack([outer, t], -1), np.stack([outer[:3:-1] - 0.02, t[:3:-1]], -1), [[1e-4, t[4]]],
    ])  # fmt: skip
    a = np.arange(across) / across * 2 * np.pi
    radius, height = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), across))
    points = np.stack([radius * np.cos(a), radius * np.sin(a), height], -1)
    inner = np.broadcast_to((np.arange(len(profile)) > rings + 1).astype(float)[:, None], points.shape[:2])
    vertices, faces, fields = _grid(points, wrap_rows=False, wrap_columns=True, inside=inner)
    return vertices, faces[:, ::-1].copy(), fields


def drape(rings: int = 110, across: int = 220) -> Built:
    """A cloth over a hidden ball: smooth on top, falling in folds that grow; field `hem`: metres above the hem."""
    s = np.linspace(0, 1.18, rings)[:, None]
    a = (np.arange(across) / across * 2 * np.pi)[None, :]
    bend = 0.32 * np.pi / 2
    flat = s < bend
    angle = np.minimum(s / 0.32, np.pi / 2)
    fall = np.maximum(s - bend, 0)
    radius = 0.32 * np.sin(angle) + 0.16 * fall
    folds = 0.20 * fall * (np.sin(9 * a + 1.1 * np.sin(2 * a)) + 0.35 * np.sin(17 * a + 4 * fall + 1.0))
    radius = np.where(flat, radius, radius + folds)
    height = 0.84 - 0.32 * (1 - np.cos(angle)) - fall * 0.94 + 0.03 * np.sin(3 * a) * fall
    points = np.stack([radius * np.cos(a), radius * np.sin(a), np.broadcast_to(height, radius.shape)], -1)
    points[..., 2] -= points[..., 2].min()
    hem = np.broadcast_to(s.max() - s, points.shape[:2])
    vertices, faces, fields = _grid(points, wrap_rows=False, wrap_columns=True, hem=hem)
    return vertices, faces, fields


def _grid(points: Array, wrap_rows: bool, wrap_columns: bool, **fields: Array) -> Built:
    rows, columns = points.shape[:2]
    r, c = np.meshgrid(np.arange(rows - (not wrap_rows)), np.arange(columns - (not wrap_columns)), indexing="ij")
    below, right = (r + 1) % rows, (c + 1) % columns
    faces = np.stack([r * columns + c, below * columns + c, below * columns + right, r * columns + right], -1)
    vertices = points.reshape(-1, 3)
    x, y, z = vertices.T
    named = {name: np.ascontiguousarray(values, dtype=np.float64).ravel() for name, values in fields.items()}
    return vertices, faces.reshape(-1, 4).astype(np.int32), {"x": x, "y": y, "z": z, **named}
