"""Losses of a fit as method.md section 2 states them: NumPy, float64, values without gradients.

Images are those of a crop (targets.py); every loss is a sum over pixels of the subject over the matte's sum. Depths are
mean depths over the subject's height, so that weights do not depend on its size.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from yesnt.gaussians.records import View
from yesnt.gaussians.targets import INSIDE, Target

F64 = NDArray[np.float64]

WINDOW = 7
"""Side of the windows of SSIM, in pixels."""

C1, C2 = 0.01**2, 0.03**2
"""Constants of SSIM (Wang et al. 2004)."""

SOLID = 0.6
"""Accumulated opacity from which a pixel has a depth and a normal to be regularised."""

SOFT = 0.05
"""Difference of coverage below which the matte's loss is quadratic: an absolute value alone never rests."""


def color_loss(color: F64, target: Target, ssim_share: float) -> float:
    """(1 - share) L1 + share (1 - SSIM), means over the matte and the three channels."""
    wanted = target.color.astype(np.float64)
    l1 = np.abs(color - wanted).sum()
    dssim = (1 - ssim_map(color, wanted)).sum()
    return float(((1 - ssim_share) * l1 + ssim_share * dssim) / (3 * target.pixels))


def ssim_map(x: F64, y: F64) -> F64:
    """SSIM of two images [H, W, 3] per pixel and channel, over square windows; black outside."""

    def mean(image: F64) -> F64:
        return uniform_filter(image, (WINDOW, WINDOW, 1), mode="constant")

    mx, my = mean(x), mean(y)
    vx, vy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return (2 * mx * my + C1) * (2 * xy + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))


def matte_loss(alpha: F64, target: Target) -> float:
    """Huber loss of the coverage, over `SOFT`: it pulls opacity up inside the matte and pushes it down outside."""
    d = np.abs(alpha - target.matte)
    return float(np.where(d < SOFT, d * d / (2 * SOFT), d - SOFT / 2).sum() / target.pixels)


def distortion_loss(alpha: F64, depth: F64, square: F64, target: Target) -> float:
    """Sum over pairs of Gaussians of weights and squared distance in depth (depths over the subject's height)."""
    return float((alpha * square - depth * depth).sum() / target.pixels)


def solid(alpha: F64, target: Target) -> NDArray[np.bool_]:
    """Pixels whose geometry is regularised: the subject alone, and opaque."""
    return (alpha > SOLID) & (target.matte > INSIDE)


def depth_loss(z: F64, ok: NDArray[np.bool_], delta: float, jump: float, pixels: float) -> float:
    """The paper's L_depth: Huber of dz/dx and dz/dy between neighbours that are both solid.

    Steps above `jump` are occlusions inside the subject, not roughness of its surface; they count nothing.
    """
    total = 0.0
    for axis in (0, 1):
        d, both = np.abs(np.diff(z, axis=axis)), np.logical_and(*_neighbours(ok, axis))
        both = both & (d < jump)
        total += np.where(d <= delta, d * d / 2, delta * (d - delta / 2))[both].sum()
    return float(total / pixels)


def edge_weights(color: NDArray[np.floating], sigma: float) -> F64:
    """exp(-|grad I|^2 / (2 sigma^2)) per pixel, by central differences over the three channels."""
    image = np.asarray(color, np.float64)
    down, across = np.gradient(image, axis=(0, 1))
    return np.exp(-((down**2 + across**2).sum(-1)) / (2 * sigma**2))


def normal_loss(normal: F64, ok: NDArray[np.bool_], edges: F64, pixels: float) -> float:
    """The paper's L_normal: edge-aware squared Laplacian of unit normals, where all four neighbours are solid."""
    n = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    laplacian = n[:-2, 1:-1] + n[2:, 1:-1] + n[1:-1, :-2] + n[1:-1, 2:] - 4 * n[1:-1, 1:-1]
    return float((edges[1:-1, 1:-1] * (laplacian**2).sum(-1))[_surrounded(ok)].sum() / pixels)


def consistency_loss(z: F64, normal: F64, ok: NDArray[np.bool_], view: View, pixels: float, jump: float) -> float:
    """1 - n . n_depth, n_depth from central differences of the points at depth z; both towards the camera."""
    n = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    points = view.rays() * z[..., None]
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    by_depth = np.cross(down, across)
    by_depth /= np.maximum(np.linalg.norm(by_depth, axis=-1, keepdims=True), 1e-12)
    smooth = (np.abs(across[..., 2]) < 2 * jump) & (np.abs(down[..., 2]) < 2 * jump)
    return float((1 - (n[1:-1, 1:-1] * by_depth).sum(-1))[_surrounded(ok) & smooth].sum() / pixels)


def _neighbours(ok: NDArray[np.bool_], axis: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    return (ok[1:], ok[:-1]) if axis == 0 else (ok[:, 1:], ok[:, :-1])


def _surrounded(ok: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """[H - 2, W - 2]: a pixel and its four neighbours are solid."""
    return ok[1:-1, 1:-1] & ok[:-2, 1:-1] & ok[2:, 1:-1] & ok[1:-1, :-2] & ok[1:-1, 2:]
