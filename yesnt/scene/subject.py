"""The relit subject as the set sees it: a mesh that carries the light that it sends out.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.indirect import IndirectLight, PixelRays
from yesnt.relight.points import Surface
from yesnt.relight.proxy import OPEN, ProxyScene

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_NEAR = 0.03
"""Distance along the view, metres, within which a point of the proxy lies on the surface that a pixel shows."""

_FACING = 0.2  # least cosine to the delivered camera of a triangle that its picture is read for


class Hits(NamedTuple):
    """Where R rays meet the subject.

    Attributes:
        face: [R] triangle.
        point: [R, 3] world metres.
        u: [R] barycentric weight of the triangle's second corner.
        v: [R] of its third.
        direction: [R, 3] unit, world, of the ray.
    """

    face: I32
    point: F32
    u: F32
    v: F32
    direction: F32


def hits_of(mesh: ProxyScene, origin: F32, direction: F32) -> tuple[Hits, NDArray[np.intp]]:
    """Where rays [R] meet a mesh, and the numbers of those that do."""
    met = mesh.trace(origin, direction)
    known = np.flatnonzero(met["primID"] != OPEN)
    far, u, v = (met[name][known].astype(np.float32) for name in ("tfar", "u", "v"))
    aim = direction[known]
    return Hits(met["primID"][known].astype(np.int32), origin[known] + aim * far[:, None], u, v, aim), known


@dataclass(frozen=True)
class Subject:
    """The subject in one frame.

    Attributes:
        mesh: F triangles.
        light: radiance of these triangles, and of those of the set behind them in the same list.
        surface: what the delivered camera sees.
        radiance: [H, W, 3] straight, what the delivered view shows of it without metal's reflections.
    """

    mesh: ProxyScene
    light: IndirectLight
    surface: Surface
    radiance: F32

    def coarse(self, face: I32, direction: F32) -> F32:
        """Radiance [R, 3] that comes from triangles [R] along rays [R, 3]; one colour a triangle."""
        aim = np.zeros(len(face), np.int32)
        rays = PixelRays(face[:, None], np.zeros((3, 1), np.float32), direction, aim)
        return np.ascontiguousarray(self.light.towards(rays)[:, :, 0].T)

    def fine(self, hits: Hits) -> F32:
        """Radiance [R, 3] as a mirror shows it: the delivered picture where it shows the point, else the vertices'."""
        found = self.coarse(hits.face, hits.direction) - self.light.diffuse[hits.face]
        corners = self.mesh.faces[hits.face]
        weights = 1 - hits.u - hits.v, hits.u, hits.v
        smooth = sum(w[:, None] * self._vertices[corners[:, k]] for k, w in enumerate(weights))
        shown, known = self._pictured(hits)
        return (found + np.where(known[:, None], shown, smooth)).astype(np.float32)

    @cached_property
    def _vertices(self) -> F32:
        """Diffuse radiance [V, 3] of the vertices: the mean of their triangles."""
        count = len(self.mesh.vertices)
        corner = self.mesh.faces.reshape(-1)
        colour = np.repeat(self.light.diffuse[: len(self.mesh.faces)], 3, axis=0)
        number = np.maximum(np.bincount(corner, minlength=count), 1)
        return np.stack([np.bincount(corner, colour[:, k], count) / number for k in range(3)], -1).astype(np.float32)

    def _pictured(self, hits: Hits) -> tuple[F32, NDArray[np.bool_]]:
        """Bilinear samples [R, 3] of the delivered picture, and where it shows the points [R]."""
        camera, frame = self.surface.camera, self.surface.frame
        place = camera.project(hits.point, frame)
        view = camera.position(frame) - hits.point
        view = view / np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
        facing = (self.mesh.normals[hits.face] * view).sum(axis=1) > _FACING
        x, y = (np.nan_to_num(place[:, k] - 0.5, nan=-9.0) for k in (0, 1))
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        total, weight = np.zeros((len(x), 3)), np.zeros(len(x))
        height, width = self.surface.opacity.shape
        for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
            r, c = row + down, column + across
            inside = (r >= 0) & (c >= 0) & (r < height) & (c < width)
            r, c = np.where(inside, r, 0), np.where(inside, c, 0)
            share = (1 - abs(y - row - down)) * (1 - abs(x - column - across))
            near = np.abs(self.surface.z[r, c] - place[:, 2]) < _NEAR
            share = np.where(inside & near & (self.surface.opacity[r, c] > 0.5), share, 0)
            total += share[:, None] * self.radiance[r, c]
            weight += share
        return (total / np.maximum(weight, 1e-9)[:, None]).astype(np.float32), facing & (weight > 0.5)
