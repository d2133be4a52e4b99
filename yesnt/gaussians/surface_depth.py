"""Depth at which the opacity accumulated along a ray reaches a level: where the surface of a field lies for a camera.

A Gaussian of opacity o, distance q from the ray and precision A along it adds, up to the depth t,
alpha(t) = o exp(-(q + A max(t* - t, 0)^2) / 2); the opacity is O(t) = 1 - prod(1 - alpha(t)) over all Gaussians
(method.md, section 2). It is the same function whose level set is the proxy mesh (opacity.py), for the ray's own
camera. The depth t* of the Gaussian at which the light falls below one half lies behind it, by the thickness of that
Gaussian and of all that follow.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.compiled import entry, kernel
from yesnt.gaussians.composite import evaluate, splat_at
from yesnt.gaussians.field import rotation_matrices
from yesnt.gaussians.project import OPACITY_CHANNEL, TILE, GaussianArrays, Pinhole, Projected
from yesnt.gaussians.reference import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from yesnt.gaussians.tiles import TileLists
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]

HALVINGS = 24
"""Of the interval in which the level is reached."""


def along_precision(gaussians: GaussianArrays, pinhole: Pinhole) -> NDArray[np.float64]:
    """Precision [N] of Gaussians along the ray through their centre, by planar depth, 1 / m^2; 0 behind the camera."""
    center = (gaussians.positions.astype(np.float64) - pinhole.position) @ pinhole.rotation.T
    z = center[:, 2]
    ray = center / np.where(z > 0, z, np.inf)[:, None]
    axes = pinhole.rotation @ rotation_matrices(gaussians.rotations.astype(np.float64))
    variances = np.exp(2.0 * gaussians.log_scales.astype(np.float64)) + gaussians.added[:, None]
    return np.asarray((np.einsum("nij,ni->nj", axes, ray) ** 2 / variances).sum(axis=1))


@kernel
def opacity_until(t: Any, count: Any, ray: Any) -> Any:
    """Opacity accumulated up to the depth t; rows of ray [4, G]: opacity on the ray, t*, precision, where it begins."""
    through = 1.0
    for j in range(count):
        if ray[3, j] < t:
            apart = max(ray[1, j] - t, 0.0)
            alpha = min(ray[0, j] * math.exp(-0.5 * ray[2, j] * apart * apart), ALPHA_MAX)
            through *= 1 - (alpha if alpha >= ALPHA_MIN else 0.0)
    return 1 - through


@kernel
def depth_of_level(level: Any, count: Any, ray: Any) -> Any:
    """The least depth at which the opacity reaches a level; 0 if it never does."""
    near, far = np.inf, 0.0
    for j in range(count):
        near, far = min(near, ray[3, j]), max(far, ray[1, j])
    if opacity_until(far, count, ray) < level:
        return 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        if opacity_until(middle, count, ray) < level:
            near = middle
        else:
            far = middle
    return far


@kernel
def gather_ray(x: Any, y: Any, members: Any, scene: Any, ray: Any) -> Any:
    """Writes the Gaussians of the ray (x, y, 1) that the renderer composites to ray [4, G]; returns their number."""
    splats, precision, near = scene
    count, passed = 0, np.float32(1)
    for i in members:
        p = evaluate(splat_at(splats, i), x, y, passed, near)
        if p.alpha > 0:
            passed = passed - p.alpha * passed
            opacity, along = splats[i, OPACITY_CHANNEL] * p.response, precision[i] / p.inverse
            ray[0, count], ray[1, count], ray[2, count] = opacity, p.t, along
            ray[3, count] = p.t - math.sqrt(2 * math.log(max(opacity / ALPHA_MIN, 1.0)) / along)
            count += 1
        if passed <= TRANSMITTANCE_MIN:
            break
    return count


@entry
def fill_depths(first: Any, last: Any, scene: Any, lists: Any, pinhole: Any, level: Any, out: Any) -> Any:
    """Writes the depths of the level to out [rows, columns], whole tiles, for tiles [first, last)."""
    columns = out.shape[1] // TILE
    for tile in range(first, last):
        row, column = tile // columns, tile % columns
        members = lists.members[lists.starts[tile] : lists.starts[tile + 1]]
        ray = np.empty((4, len(members)))
        for k in range(TILE * TILE):
            v, u = row * TILE + k // TILE, column * TILE + k % TILE
            x, y = np.float32((u + 0.5 - pinhole.cx) / pinhole.fx), np.float32((v + 0.5 - pinhole.cy) / pinhole.fy)
            out[v, u] = depth_of_level(level, gather_ray(x, y, members, scene, ray), ray)


def surface_depth(
    gaussians: GaussianArrays, projected: Projected, lists: TileLists, pinhole: Pinhole, level: float
) -> F32:
    """Planar depth [H, W], metres, at which the opacity along each pixel's ray reaches a level; 0 where it never does.

    The bits do not depend on the number of threads.

    Args:
        gaussians: as rendered.
        projected: of the forward pass (`Raster`).
        lists: of the forward pass.
        pinhole: the view.
        level: of the opacity, in (0, 1).
    """
    rows, columns = -(-pinhole.height // TILE), -(-pinhole.width // TILE)
    scene = (projected.splats, along_precision(gaussians, pinhole), np.float32(pinhole.near))
    out = np.zeros((rows * TILE, columns * TILE), np.float32)
    over_ranges(rows * columns, lambda first, last: fill_depths(first, last, scene, lists, pinhole, level, out))
    return out[: pinhole.height, : pinhole.width].copy()
