"""Opacity of a Gaussian field at points: accumulated along the rays from a camera to the points.

A point's opacity is the smallest over all cameras that have it in their picture. Outside the subject some camera looks
at it through empty space, so it is 0; inside, every camera looks through the surface, so it is near 1 (Gaussian Opacity
Fields; docs/method.md section 2). Accumulated opacity is 1 - prod(1 - alpha), so the Gaussians need no order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.compiled import compiled
from yesnt.gaussians.field import GaussianField

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

LEAST_ALPHA = 1 / 255
LARGEST_ALPHA = 0.99

_TILES = 128  # columns and rows of the grid over a picture in which Gaussians are looked up
_OPAQUE = 1e-4  # transmittance at which the renderer stops as well


class Ellipsoids(NamedTuple):
    """The Gaussians as ellipsoids.

    Attributes:
        centres: [N, 3] world metres.
        whitening: [N, 3, 3] world offsets to multiples of the standard deviations along the own axes.
        covariances: [N, 3, 3] world, m^2.
        opacities: [N].
    """

    centres: F64
    whitening: F64
    covariances: F64
    opacities: F64


class Tiles(NamedTuple):
    """Which ellipsoids may be seen in which tile of a picture.

    Attributes:
        start: [2] column and row, pixels, at which the grid begins; it covers the picture.
        size: [2] columns and rows, pixels, of a tile.
        offsets: [tiles + 1] where a tile's members begin.
        members: [pairs] numbers of ellipsoids, nearest first.
        nearest: [N] planar depth at which each ellipsoid begins.
    """

    start: F64
    size: F64
    offsets: I64
    members: NDArray[np.int32]
    nearest: F64


class _Rays(NamedTuple):
    """Rays from a camera to points: offsets [P, 3] in the world, planar depth [P] and tile [P] of their ends."""

    ends: F64
    z: F64
    tile: I64


def ellipsoids(field: GaussianField) -> Ellipsoids:
    """The Gaussians of a field that can be seen at all, smoothing filter included."""
    seen = field.opacities >= LEAST_ALPHA
    scales = np.sqrt(field.variances[seen])
    whitening = field.axes[seen].transpose(0, 2, 1) / scales[:, :, None]
    return Ellipsoids(
        field.positions[seen].astype(np.float64), np.ascontiguousarray(whitening),
        field.covariances[seen], field.opacities[seen],
    )  # fmt: skip


def opacity_at(
    points: F64, shapes: Ellipsoids, cameras: Sequence[tuple[Camera, int | None]], level: float | None = None
) -> F64:
    """Smallest opacity [P] over the cameras that have a point in their picture; 1 where none has.

    Args:
        points: [P, 3] world metres.
        shapes: of the field.
        cameras: with the frame whose pose they have; None: their only one.
        level: if given, only the side of it on which a point lies is exact; this is several times faster.
    """
    found = np.ones(len(points))
    for camera, frame in cameras:
        left = np.nonzero(found >= (level or 0))[0]
        pixels = camera.project(points[left], frame)
        with np.errstate(invalid="ignore"):
            x, y, z = pixels.T
            shown = (z > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        left = left[shown]
        if len(left):
            values = _seen_from(points[left], shapes, camera.pose(frame), 1.0 if level is None else level)
            found[left] = np.minimum(found[left], values)
    return found


def _seen_from(points: F64, shapes: Ellipsoids, pose: F64, enough: float) -> F64:
    """Opacity [P] along the rays from a camera; counting stops where it has reached `enough`."""
    offset = (points - pose[:3, 3]) @ pose[:3, :3]
    plane = offset[:, :2] / offset[:, 2:]  # on z = 1, distortion undone
    tiles = cast_tiles(shapes, pose, plane)
    # Neighbours in a tile read the same ellipsoids.
    place = np.clip((plane - tiles.start) / tiles.size, 0, _TILES - 1).astype(np.int64)
    tile = place[:, 1] * _TILES + place[:, 0]
    order = np.argsort(tile, kind="stable")
    rays = (points - pose[:3, 3])[order]
    whitened = np.einsum("nij,nj->ni", shapes.whitening, shapes.centres - pose[:3, 3])
    values = np.empty(len(points))
    through = max(1 - enough, _OPAQUE)
    _accumulate(_Rays(rays, offset[order, 2], tile[order]), tiles, shapes, whitened, through, values)
    result = np.empty(len(points))
    result[order] = values
    return result


def cast_tiles(shapes: Ellipsoids, pose: F64, plane: F64) -> Tiles:
    """Looks up which ellipsoids can be seen through which tile of a grid over points of a camera's plane z = 1.

    An ellipsoid with offset m and covariance S, cut at q standard deviations squared, has an outline with the dual
    conic D = q S - m m'. Its extent along x is (D13 -+ sqrt(D13^2 - D11 D33)) / D33, and alike along y.

    Args:
        shapes: the ellipsoids.
        pose: `world_from_camera` [4, 4].
        plane: [P, 2] points that will be looked up.
    """
    turn = pose[:3, :3]
    offset = (shapes.centres - pose[:3, 3]) @ turn
    cut = 2 * np.log(np.maximum(shapes.opacities / LEAST_ALPHA, 1))
    dual = cut[:, None, None] * (turn.T @ shapes.covariances @ turn) - offset[:, :, None] * offset[:, None, :]
    bounded = (dual[:, 2, 2] < 0) & (offset[:, 2] > 0)
    behind = (dual[:, 2, 2] < 0) & (offset[:, 2] <= 0)
    low, high = plane.min(axis=0), plane.max(axis=0)
    size = np.maximum((high - low) / _TILES, 1e-12)
    first, last = np.zeros((len(offset), 2), np.int64), np.full((len(offset), 2), _TILES - 1)
    for axis in (0, 1):
        d11, d13, d33 = dual[:, axis, axis], dual[:, axis, 2], dual[:, 2, 2]
        half = np.sqrt(np.maximum(d13 * d13 - d11 * d33, 0))
        ends = np.stack([d13 + half, d13 - half]) / np.where(bounded, d33, -1)
        ends = np.clip((ends - low[axis]) / size[axis], -1, _TILES)
        first[bounded, axis] = np.floor(ends[0, bounded]).astype(np.int64)
        last[bounded, axis] = np.floor(ends[1, bounded]).astype(np.int64)
    outside = behind | (last < 0).any(axis=1) | (first >= _TILES).any(axis=1)
    # What lies just beyond an edge of the grid counts for the tiles at the edge, where points are rounded to.
    first, last = np.clip(first, 0, _TILES - 1), np.clip(last, 0, _TILES - 1)
    first[outside], last[outside] = 0, -1
    counts = np.zeros(_TILES * _TILES + 1, np.int64)
    _count(first, last, counts)
    offsets = np.cumsum(counts)
    nearest = offset[:, 2] - np.sqrt(cut * np.einsum("i,nij,j->n", turn[:, 2], shapes.covariances, turn[:, 2]))
    members = np.empty(offsets[-1], np.int32)
    _fill(np.argsort(nearest, kind="stable"), first, last, offsets[:-1].copy(), members)
    return Tiles(low, size, offsets, members, nearest)


@compiled(error_model="numpy")
def _count(first: I64, last: I64, counts: I64) -> None:
    """counts[tile + 1] = members of a tile."""
    for n in range(len(first)):
        for row in range(first[n, 1], last[n, 1] + 1):
            for column in range(first[n, 0], last[n, 0] + 1):
                counts[row * _TILES + column + 1] += 1


@compiled(error_model="numpy")
def _fill(order: I64, first: I64, last: I64, place: I64, members: NDArray[np.int32]) -> None:
    """Writes the members of each tile in an order."""
    for n in order:
        for row in range(first[n, 1], last[n, 1] + 1):
            for column in range(first[n, 0], last[n, 0] + 1):
                tile = row * _TILES + column
                members[place[tile]] = n
                place[tile] += 1


@compiled(error_model="numpy", nogil=True, parallel=True)
def _accumulate(rays: _Rays, tiles: Tiles, shapes: Ellipsoids, whitened: F64, least: float, values: F64) -> None:
    """values[p] = opacity along the ray from the camera to its end, until the transmittance falls below `least`.

    In whitened space, with ray a and centre b: the squared distance of ray and centre is |a x b|^2 / |a|^2, which is
    nearest at t = a.b / |a|^2; the ray ends at t = 1.
    """
    for p in prange(len(rays.z)):
        x, y, z = rays.ends[p, 0], rays.ends[p, 1], rays.ends[p, 2]
        through = 1.0
        for j in range(tiles.offsets[rays.tile[p]], tiles.offsets[rays.tile[p] + 1]):
            n = tiles.members[j]
            if tiles.nearest[n] > rays.z[p]:
                break
            w = shapes.whitening[n]
            a0 = w[0, 0] * x + w[0, 1] * y + w[0, 2] * z
            a1 = w[1, 0] * x + w[1, 1] * y + w[1, 2] * z
            a2 = w[2, 0] * x + w[2, 1] * y + w[2, 2] * z
            b0, b1, b2 = whitened[n, 0], whitened[n, 1], whitened[n, 2]
            along = a0 * b0 + a1 * b1 + a2 * b2
            if along <= 0:  # nearest behind the camera
                continue
            square = a0 * a0 + a1 * a1 + a2 * a2
            c0, c1, c2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
            apart = (c0 * c0 + c1 * c1 + c2 * c2) / square
            beyond = along / square - 1
            if beyond > 0:
                apart += square * beyond * beyond
            if apart > 12.5:  # alpha below 1 / 255 for any opacity
                continue
            alpha = min(shapes.opacities[n] * math.exp(-0.5 * apart), LARGEST_ALPHA)
            if alpha < LEAST_ALPHA:
                continue
            through *= 1 - alpha
            if through <= least:
                break
        values[p] = 1 - through


def opacity_reference(points: F64, shapes: Ellipsoids, eye: F64) -> F64:
    """Opacity [P] along the rays from a point to others; every Gaussian is evaluated as method.md has it."""
    ray, centre = points[:, None] - eye, shapes.centres - eye  # [P, 1, 3], [N, 3]
    precision = np.linalg.inv(shapes.covariances)
    quadratic = np.einsum("pni,nij,pnj->pn", ray + 0 * centre, precision, ray + 0 * centre)
    linear = -2 * np.einsum("pni,nij,nj->pn", ray + 0 * centre, precision, centre)
    constant = np.einsum("ni,nij,nj->n", centre, precision, centre)
    t = -linear / (2 * quadratic)
    end = np.minimum(t, 1)
    alpha = shapes.opacities * np.exp(-0.5 * (quadratic * end * end + linear * end + constant))
    alpha = np.minimum(alpha, LARGEST_ALPHA)
    alpha[(alpha < LEAST_ALPHA) | (t <= 0)] = 0
    return np.asarray(1 - np.prod(1 - alpha, axis=1))
