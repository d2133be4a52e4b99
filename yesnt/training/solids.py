"""Random surfaces for training: surfaces of revolution, tubes along a curve, assemblies, draped cloth.

Curves and profiles are random series, so that none equals a shape of the capture stage (`yesnt.capture_stage.shapes`),
on which the model is evaluated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]


@dataclass(frozen=True)
class Solid:
    """A triangle mesh with a coordinate along its length.

    Attributes:
        vertices: [V, 3], largest extent about 1.
        faces: [F, 3] triangles, counter-clockwise seen from outside.
        along: [V] coordinate along the length: the integer part is the number of the part, the fraction the position on
            it.
        uv: [V, 2] surface coordinates in the units of `vertices`.
    """

    vertices: Float64
    faces: Int32
    along: Float64
    uv: Float64

    @classmethod
    def of_grid(cls, points: Float64, along: Float64, wrap: tuple[bool, bool]) -> Solid:
        """Builds a mesh from a grid of points; faces are oriented so that the enclosed volume is positive.

        Args:
            points: [R, C, 3]; rows run along the solid.
            along: [R] coordinate along the length.
            wrap: whether the grid closes along rows, and along columns.
        """
        rows, columns = points.shape[:2]
        r, c = np.meshgrid(np.arange(rows - (not wrap[0])), np.arange(columns - (not wrap[1])), indexing="ij")
        below, right = (r + 1) % rows, (c + 1) % columns
        corners = [r * columns + c, below * columns + c, below * columns + right, r * columns + right]
        a, b, d, e = (corner.ravel() for corner in corners)
        faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, e], -1)]).astype(np.int32)
        down, around = _lengths(points, 0), _lengths(points, 1)
        uv = np.stack(np.broadcast_arrays(around[None, :], down[:, None]), -1).reshape(-1, 2)
        spread = np.broadcast_to(along[:, None], (rows, columns)).ravel()
        vertices = points.reshape(-1, 3)
        turned = faces if _volume(vertices, faces) > 0 else np.ascontiguousarray(faces[:, ::-1])
        return cls(vertices, turned, np.ascontiguousarray(spread), np.ascontiguousarray(uv))

    @classmethod
    def join(cls, parts: list[Solid]) -> Solid:
        """Joins several solids, numbered in their order."""
        starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
        return cls(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]).astype(np.int32),
            np.concatenate([part.along % 1 + n for n, part in enumerate(parts)]),
            np.concatenate([part.uv for part in parts]),
        )

    def placed(self, turn: Float64, scale: float | Float64, shift: Float64) -> Solid:
        """Returns the solid scaled, then rotated by `turn` [3, 3], then moved by `shift` [3]."""
        return Solid(self.vertices * scale @ turn.T + shift, self.faces, self.along, self.uv * np.mean(scale))


def _volume(vertices: Float64, faces: Int32) -> float:
    """Signed volume, positive if faces are counter-clockwise from outside; the centroid closes open surfaces."""
    a, b, c = (vertices[faces[:, k]] - vertices.mean(0) for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _lengths(points: Float64, axis: int) -> Float64:
    """Arc length along the middle line of the grid, along an axis."""
    middle = np.take(points, points.shape[1 - axis] // 2, axis=1 - axis)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])


def _series(rng: np.random.Generator, t: Float64, count: int, fall: float) -> Float64:
    """Random sum of sines over t, of about unit size."""
    total = np.zeros_like(t)
    for k in range(1, count + 1):
        total = total + rng.normal() * k**-fall * np.sin(2 * np.pi * (k * t / 2 + rng.random()))
    return total


def vessel(rng: np.random.Generator, rings: int = 90, across: int = 72) -> Solid:
    """Draws a surface of revolution: bowl, jar, goblet or bottle; open or closed.

    Args:
        rng: source of every choice.
        rings: samples along the profile.
        across: samples around the axis.
    """
    t = np.linspace(0, 1, rings)
    radius = np.exp(0.45 * _series(rng, t, int(rng.integers(2, 6)), 1.0)) * rng.uniform(0.12, 0.45)
    radius = np.clip(radius, 0.03, 0.6)
    if rng.random() < 0.4:
        radius = radius * (1 + rng.uniform(0, 0.03) * np.sin(2 * np.pi * rng.integers(8, 30) * t))
    outer = np.stack([radius, t], -1)
    wall = rng.uniform(0.01, 0.04)
    if rng.random() < 0.6:
        inner = np.stack([np.maximum(radius - wall, 0.01), t], -1)[:4:-1]
        profile = np.concatenate([[[1e-4, 0.0]], outer, inner, [[1e-4, t[5]]]])
    else:
        profile = np.concatenate([[[1e-4, 0.0]], outer, [[1e-4, 1.0]]])
    angle = np.arange(across) / across * 2 * np.pi
    wide, high = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), across))
    flutes = 1 + (rng.random() < 0.2) * rng.uniform(0.01, 0.06) * np.cos(rng.integers(6, 24) * angle)[None]
    points = np.stack([wide * flutes * np.cos(angle), wide * flutes * np.sin(angle), high], -1)
    return Solid.of_grid(points[:, ::-1], np.clip(profile[:, 1], 0, 0.999), (False, True))


def tube(rng: np.random.Generator, around: int = 200, across: int = 24) -> Solid:
    """Draws a tube along a random closed curve, or along an open one with rounded ends.

    Args:
        rng: source of every choice.
        around: samples along the curve.
        across: samples around the tube.
    """
    closed = rng.random() < 0.7
    t = np.arange(around) / (around if closed else around - 1)
    period = 2 if closed else 1  # `_series` counts half turns
    curve = np.stack([_series(rng, period * t, int(rng.integers(1, 4)), 0.6) for _ in range(3)], -1)
    curve += np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t), np.zeros_like(t)], -1) * rng.uniform(0, 1.5)
    extent = float(np.ptp(curve, axis=0).max())
    curve /= extent
    radius = rng.uniform(0.03, 0.11) * (1 + 0.25 * rng.random() * np.sin(2 * np.pi * (t * rng.integers(1, 6))))
    if not closed:
        radius = radius * np.sqrt(np.clip(np.minimum(t, 1 - t) * 14, 1e-4, 1))
    side, above = _frames(curve, closed)
    angle = np.arange(across) / across * 2 * np.pi
    ring = side[:, None] * np.cos(angle)[None, :, None] + above[:, None] * np.sin(angle)[None, :, None]
    return Solid.of_grid(curve[:, None] + radius[:, None, None] * ring, np.minimum(t, 0.999), (closed, True))


def _frames(curve: Float64, closed: bool) -> tuple[Float64, Float64]:
    """Two unit normals [T, 3] along a curve with minimal rotation.

    On a closed curve the remaining twist is distributed evenly.
    """
    forward = np.roll(curve, -1, 0) - np.roll(curve, 1, 0) if closed else np.gradient(curve, axis=0)
    forward = forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    side = np.zeros_like(curve)
    last = np.cross(forward[0], np.eye(3)[int(np.argmin(np.abs(forward[0])))])
    for n, ahead in enumerate(forward):
        last = last - (last @ ahead) * ahead
        last = last / max(float(np.linalg.norm(last)), 1e-9)
        side[n] = last
    above = np.cross(forward, side)
    if closed:
        first = side[0] - (side[0] @ forward[-1]) * forward[-1]
        twist = np.arctan2(first @ above[-1], first @ side[-1]) * np.linspace(0, 1, len(curve))[:, None]
        side, above = np.cos(twist) * side + np.sin(twist) * above, np.cos(twist) * above - np.sin(twist) * side
    return side, above


def block(rng: np.random.Generator, rings: int = 36, across: int = 48) -> Solid:
    """Draws a superellipsoid between a ball and a rounded box, possibly tapered or bent.

    Args:
        rng: source of every choice.
        rings: samples of latitude.
        across: samples of longitude.
    """
    v = np.linspace(-np.pi / 2, np.pi / 2, rings)[:, None]
    u = np.linspace(-np.pi, np.pi, across, endpoint=False)[None]
    e, f = rng.choice([0.25, 0.4, 0.7, 1.0], 2)

    def power(x: Float64, p: float) -> Float64:
        return np.sign(x) * np.abs(x) ** p

    points = np.stack(np.broadcast_arrays(
        power(np.cos(v), e) * power(np.cos(u), f), power(np.cos(v), e) * power(np.sin(u), f), power(np.sin(v), e)
    ), -1) * 0.5  # fmt: skip
    points[..., :2] *= 1 + rng.normal(0, 0.35) * points[..., 2:]
    points[..., 0] += rng.normal(0, 0.5) * points[..., 2] ** 2
    return Solid.of_grid(points, np.clip((v[:, 0] / np.pi + 0.5), 0, 0.999), (False, True))


def device(rng: np.random.Generator) -> Solid:
    """Draws an assembly like a handheld device: a body, possibly a ring, and small parts on its surface."""
    size = np.array([rng.uniform(0.15, 0.4), rng.uniform(0.15, 0.4), rng.uniform(0.5, 1)])
    parts = [block(rng).placed(np.eye(3), size, np.zeros(3))]
    if rng.random() < 0.5:
        parts.append(tube(rng).placed(_turned(rng), rng.uniform(0.5, 1.0), rng.normal(0, 0.2, 3)))
    for _ in range(int(rng.integers(1, 7))):
        at = rng.normal(0, 1, 3)
        at = at / np.linalg.norm(at) * size / 2
        small = rng.uniform(0.03, 0.3, 3) * rng.uniform(0.3, 1)
        parts.append(block(rng, 20, 28).placed(_turned(rng), small, at))
    return Solid.join(parts)


def drapery(rng: np.random.Generator, rings: int = 90, across: int = 180) -> Solid:
    """Draws a cloth that hangs from a round or flat top in folds that widen downwards.

    Args:
        rng: source of every choice.
        rings: samples from the centre to the hem.
        across: samples around.
    """
    fall = np.linspace(0, 1, rings)[:, None]
    turn = (np.arange(across) / across)[None]
    top = rng.uniform(0.05, 0.5)
    height = 1 - np.maximum(fall - top, 0) / (1 - top) * rng.uniform(0.5, 1) - rng.uniform(0, 0.3) * fall**2
    radius = rng.uniform(0.2, 0.5) * np.minimum(fall / top, 1) + rng.uniform(0, 0.35) * np.maximum(fall - top, 0)
    folds = sum(
        rng.normal(0, 1) / k**0.5 * np.sin(2 * np.pi * (k * turn + rng.random()) + rng.normal(0, 2) * fall)
        for k in rng.integers(3, 24, 5)
    )
    radius = radius * (1 + rng.uniform(0.03, 0.14) * np.maximum(fall - 0.7 * top, 0) / 0.5 * folds)
    angle = 2 * np.pi * turn
    points = np.stack(np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), height), -1)
    cloth = Solid.of_grid(points, np.minimum(fall[:, 0], 0.999), (False, True))
    # The inside is a second layer: a sheet's normals can point to one side only.
    return Solid(
        np.concatenate([cloth.vertices, cloth.vertices * [0.985, 0.985, 0.997]]),
        np.concatenate([cloth.faces, cloth.faces[:, ::-1] + len(cloth.vertices)]).astype(np.int32),
        np.concatenate([cloth.along] * 2),
        np.concatenate([cloth.uv] * 2),
    )


def _turned(rng: np.random.Generator) -> Float64:
    """Random rotation [3, 3]."""
    axes, upper = np.linalg.qr(rng.standard_normal((3, 3)))
    axes = axes * np.sign(np.diag(upper))
    return axes if np.linalg.det(axes) > 0 else -axes


Builder = Callable[[np.random.Generator], Solid]

SOLIDS: tuple[Builder, ...] = (
    vessel, vessel, vessel, tube, tube, device, device, device, drapery, drapery,
)  # fmt: skip
"""Builders, as often as they are drawn."""
