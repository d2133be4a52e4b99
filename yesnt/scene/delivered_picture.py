"""Reads the delivered picture at points of the proxy, where it shows them.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.points import Surface
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.scene.vertex_materials import NEAR, covered_pixels

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

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

    def weights(self) -> tuple[F32, F32, F32]:
        """Barycentric weights [R] of the three corners."""
        return 1 - self.u - self.v, self.u, self.v

    def taken(self, which: NDArray[np.intp]) -> Hits:
        """Some of the rays."""
        return Hits(self.face[which], self.point[which], self.u[which], self.v[which], self.direction[which])


def hits_of(mesh: ProxyScene, origin: F32, direction: F32) -> tuple[Hits, NDArray[np.intp]]:
    """Where rays [R] meet a mesh, and the numbers of those that do."""
    met = mesh.trace(origin, direction)
    known = np.flatnonzero(met["primID"] != OPEN)
    far, u, v = (met[name][known].astype(np.float32) for name in ("tfar", "u", "v"))
    aim = direction[known]
    return Hits(met["primID"][known].astype(np.int32), origin[known] + aim * far[:, None], u, v, aim), known


@dataclass(frozen=True)
class DeliveredPicture:
    """What the delivered camera sees of a mesh.

    Attributes:
        mesh: the proxy.
        surface: the G-buffer.
    """

    mesh: ProxyScene
    surface: Surface

    def read(self, image: F32, hits: Hits) -> tuple[F32, NDArray[np.bool_]]:
        """Bilinear samples [R, K] of an image [H, W, K] at points of the mesh, and where it shows the points [R]."""
        place = self.surface.camera.project(hits.point, self.surface.frame)
        x, y = (np.nan_to_num(place[:, k] - 0.5, nan=-9.0) for k in (0, 1))
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        total, weight = np.zeros((len(x), image.shape[-1])), np.zeros(len(x))
        solid = covered_pixels(np.asarray(self.surface.opacity, np.float32))
        height, width = solid.shape
        for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
            r, c = row + down, column + across
            inside = (r >= 0) & (c >= 0) & (r < height) & (c < width)
            r, c = np.where(inside, r, 0), np.where(inside, c, 0)
            share = (1 - abs(y - row - down)) * (1 - abs(x - column - across))
            near = np.abs(self.surface.z[r, c] - place[:, 2]) < NEAR
            share = np.where(inside & near & solid[r, c], share, 0)
            total += share[:, None] * image[r, c]
            weight += share
        return (total / np.maximum(weight, 1e-9)[:, None]).astype(np.float32), self._faces(hits) & (weight > 0.5)

    def _faces(self, hits: Hits) -> NDArray[np.bool_]:
        """Whether the triangles [R] face the camera."""
        view = self.surface.camera.position(self.surface.frame) - hits.point
        view = view / np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
        return (self.mesh.normals[hits.face] * view).sum(axis=1) > _FACING
