"""Pixels in which several surfaces of a set's mesh meet: they show all of them, by the rays that meet each.

A pixel is lit where one of its rays meets the mesh. What its other rays meet is taken from the neighbour that was lit
on the same surface, so that a piece before a floor has a soft edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.points import Pixels
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.scene.mesh_normals import CREASE

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
Places = NDArray[np.intp]

OFF = 2e-3
"""Share of its distance by which a point may be off the plane of another on the same surface."""


class EdgeMix(NamedTuple):
    """What E pixels at edges show.

    Attributes:
        pixel: [E] numbers of these pixels.
        shown: [E, N] numbers of the pixels that were lit where their N rays lead.
        weight: [E, N] share of each, which sums to 1.
    """

    pixel: Places
    shown: Places
    weight: F32

    def of(self, values: F32) -> F32:
        """Values [P, K] of all pixels, mixed at edges."""
        out = values.copy()
        out[self.pixel] = (values[self.shown] * self.weight[..., None]).sum(axis=1)
        return out


def other_surface(mesh: ProxyScene, eye: F32, pair: tuple[I32, I32], points: tuple[F32, F32]) -> NDArray[np.bool_]:
    """Whether the second of two hits [R] lies on another surface than the first: a crease or a step between them.

    Args:
        mesh: F triangles.
        eye: [3] place of the camera.
        pair: triangles [R] of both hits.
        points: [R, 3] of both hits, world metres.
    """
    first, second = (mesh.normals[face] for face in pair)
    rise = np.abs(((points[1] - points[0]) * first).sum(axis=1))
    bent = np.abs((first * second).sum(axis=1)) < CREASE
    return np.asarray(bent | (rise > OFF * np.linalg.norm(points[0] - eye, axis=1)))


def edge_mix(pixels: Pixels, mesh: ProxyScene, eye: F32, edge: Places, rays: F32) -> EdgeMix:
    """Finds for every ray of pixels at edges the neighbour that was lit on the surface that the ray meets.

    Args:
        pixels: P pixels, lit at one point each.
        mesh: the set.
        eye: [3] place of the camera.
        edge: [E] pixels at edges.
        rays: [E, N, 3] of these pixels, world, of any length.
    """
    count, number = rays.shape[:2]
    aim = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3).astype(np.float32)
    met = mesh.trace(np.broadcast_to(eye, aim.shape).astype(np.float32), aim)
    hit = met["primID"].astype(np.int32)
    point = eye + aim * np.where(hit != OPEN, met["tfar"], 0).astype(np.float32)[:, None]
    own = np.repeat(edge, number)
    best, shown = np.full(len(own), np.inf), own.copy()
    for candidate in _neighbours(pixels, own):
        there = (candidate >= 0) & (hit != OPEN)
        normal, at = pixels.normal[candidate], pixels.position[candidate]
        rise = np.abs(((point - at) * normal).sum(axis=1)) / np.linalg.norm(point - eye, axis=1).clip(1e-9)
        turned = np.abs((mesh.normals[hit] * normal).sum(axis=1)) < CREASE
        far = rise + 1e-3 * np.linalg.norm(point - at, axis=1)
        closer = there & ~turned & (rise < OFF) & (far < best)
        best, shown = np.where(closer, far, best), np.where(closer, candidate, shown)
    weight = np.where(hit != OPEN, 1.0, 0.0).reshape(count, number)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1)
    return EdgeMix(edge, shown.reshape(count, number), weight.astype(np.float32))


def _neighbours(pixels: Pixels, which: Places) -> list[Places]:
    """Numbers [R] of the pixels themselves and of the eight around them; -1 where there is none."""
    height, width = pixels.shape
    number = np.full((height + 2, width + 2), -1, np.intp)
    row, column = np.divmod(pixels.index, width)
    number[row + 1, column + 1] = np.arange(len(row))
    steps = [(0, 0), *((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j)]
    return [number[row[which] + 1 + down, column[which] + 1 + across] for down, across in steps]
