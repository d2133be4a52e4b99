"""The field that a fit starts from: discs on a surface, such as the visual hull (capture/hull.py)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.field import ColorSpace, GaussianField
from yesnt.gaussians.harmonics import C0
from yesnt.gaussians.random_order import keyed_generator
from yesnt.gaussians.targets import Target

F64 = NDArray[np.float64]

WIDTH = 0.8
"""Standard deviation of a disc, of the distance between neighbouring points."""

THICKNESS = 0.1
"""Standard deviation across a disc, of that along it."""

OPACITY = 0.7

_UNSEEN = 0.4  # grey, for points that no camera sees well


def discs(
    points: NDArray[np.floating], normals: NDArray[np.floating], targets: Sequence[Target], count: int, degree: int,
    seed: int = 0, color_space: ColorSpace = "srgb",
) -> GaussianField:  # fmt: skip
    """Flat Gaussians on a surface, coloured by the cameras that face it.

    Args:
        points: [P, 3] on the surface, about evenly spread, world metres.
        normals: [P, 3] outward unit normals.
        targets: the cameras' pictures.
        count: Gaussians; fewer if there are fewer points.
        degree: of the harmonics.
        seed: of the choice of points.
        color_space: of the targets' colours.
    """
    chosen = np.sort(keyed_generator(seed, 0, 0).permutation(len(points))[:count])
    points, normals = np.asarray(points, np.float64)[chosen], np.asarray(normals, np.float64)[chosen]
    width = WIDTH * point_distance(points)
    scales = np.tile(np.log([width, width, THICKNESS * width]), (len(points), 1))
    harmonics = np.zeros((len(points), (degree + 1) ** 2, 3))
    harmonics[:, 0] = (facing_colors(points, normals, targets) - 0.5) / C0
    logits = np.full(len(points), np.log(OPACITY / (1 - OPACITY)))
    arrays = (points, scales, rotations_to(normals), logits, harmonics)
    positions, log_scales, rotations, opacity_logits, colors = (np.asarray(a, np.float32) for a in arrays)
    return GaussianField(positions, log_scales, rotations, opacity_logits, colors, color_space=color_space)


def point_distance(points: F64) -> float:
    """Distance between neighbours of a sheet of points: the fourth nearest lies at 1.09 of it on average."""
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(points).query(points, k=min(5, len(points)))
    return float(np.median(distances[:, -1])) / 1.09


def rotations_to(normals: F64) -> F64:
    """Unit quaternions [N, 4] whose rotations take the z axis to the normals."""
    q = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    q[np.linalg.norm(q, axis=1) < 1e-3] = [0, 1, 0, 0]  # straight down: any half turn about a horizontal axis
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def facing_colors(points: F64, normals: F64, targets: Sequence[Target]) -> F64:
    """Straight colours [N, 3] of points: the mean over cameras, weighted by the cube of the cosine to the normal.

    Cameras behind which a point is hidden count too; the fit corrects that.
    """
    total, weights = np.zeros((len(points), 3)), np.zeros(len(points))
    for target in targets:
        view = target.view
        local = (points - view.position) @ view.rotation.T
        z = np.where(local[:, 2] > 0, local[:, 2], np.inf)
        x = np.floor(view.fx * local[:, 0] / z + view.cx).astype(int)
        y = np.floor(view.fy * local[:, 1] / z + view.cy).astype(int)
        inside = (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height) & np.isfinite(z)
        x, y = np.where(inside, x, 0), np.where(inside, y, 0)
        to_camera = view.position - points
        cosine = (to_camera * normals).sum(1) / np.linalg.norm(to_camera, axis=1)
        weight = np.maximum(cosine, 0) ** 3 * (inside & (target.matte[y, x] > 0.95))
        total += weight[:, None] * target.color[y, x]
        weights += weight
    return np.where(weights[:, None] > 1e-3, total / np.maximum(weights, 1e-3)[:, None], _UNSEEN)


def extent(points: NDArray[np.floating]) -> float:
    """Longest side of the box around the points, metres: the subject's height."""
    return float(np.ptp(np.asarray(points, np.float64), axis=0).max())


def pixel_width(points: NDArray[np.floating], targets: Sequence[Target]) -> float:
    """Width of a pixel at the middle of the points, metres; the median over the cameras."""
    middle = np.asarray(points, np.float64).mean(axis=0)
    return float(np.median([(t.view.rotation @ (middle - t.view.position))[2] / t.view.fx for t in targets]))
