"""Losses of a fit with their gradients by the rasteriser's images (method.md section 2; loss_reference.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.loss_kernels import Geometry, GeometryWeights, geometry_losses
from yesnt.gaussians.loss_reference import C1, C2, SOFT, SOLID, WINDOW, edge_weights
from yesnt.gaussians.targets import INSIDE, Target

F32 = NDArray[np.float32]

_FAINT = 0.05  # accumulated opacity below which a pixel has no mean depth


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses; each loss is a mean over the matte.

    Attributes:
        ssim: share of 1 - SSIM in the colour loss; the rest is L1.
        matte: of the coverage.
        distortion: of the spread of a pixel's Gaussians in depth.
        consistency: of the agreement of normals with the depth's own normals.
        depth: the paper's L_depth; 0 gives plain Gaussian Opacity Fields.
        normal: the paper's L_normal; 0 gives plain Gaussian Opacity Fields.
        delta: of L_depth's Huber loss, of the subject's height.
        sigma: of L_normal's edges, in the units of the colour.
        jump: difference of depth between neighbours that is an occlusion, of the subject's height.
    """

    ssim: float = 0.2
    matte: float = 0.5
    distortion: float = 0.0
    consistency: float = 0.2
    depth: float = 0.0
    normal: float = 0.0
    delta: float = 0.002
    sigma: float = 0.1
    jump: float = 0.04

    @property
    def of_geometry(self) -> bool:
        """Whether a loss looks at depth or normals."""
        return max(self.distortion, self.consistency, self.depth, self.normal) > 0


@dataclass(frozen=True)
class Losses:
    """Unweighted losses of a view."""

    l1: float
    dssim: float
    matte: float
    distortion: float
    consistency: float
    depth: float
    normal: float


def view_losses(
    images: F32, target: Target, weights: LossWeights, reference_z: float, height: float
) -> tuple[Losses, F32]:
    """Losses of a rendered crop and their gradient by the images.

    Args:
        images: [12, H, W] of the rasteriser (composite.py).
        target: the picture.
        weights: of the losses; depth and normals are left out where all of theirs are 0.
        reference_z: depth about which the images' depths are given, metres.
        height: of the subject, metres.

    Returns:
        The unweighted losses, and the gradient [10, H, W] of their weighted sum.
    """
    gradient = np.zeros((10, *images.shape[1:]), np.float32)
    color = np.ascontiguousarray(np.moveaxis(images[:3], 0, -1))
    l1, dssim, by_color = _color(color, target, weights.ssim)
    gradient[:3] = np.moveaxis(by_color, -1, 0)
    matte, gradient[6] = _matte(images[6], target, weights.matte)
    shape = (0.0, 0.0, 0.0, 0.0)
    if weights.of_geometry:
        shape = (
            _distortion(images, target, weights.distortion / height**2, gradient) / height**2,
            *_geometry(images, target, weights, (reference_z, height), gradient),
        )
    return Losses(l1, dssim, matte, *shape), gradient


def _color(x: F32, target: Target, share: float) -> tuple[float, float, F32]:
    """L1 and 1 - SSIM, means over the matte, and the gradient of their weighted sum by the colour."""
    difference, count = x - target.color, 3 * target.pixels
    by = np.float32((1 - share) / count) * np.sign(difference)
    if share == 0:
        return float(np.abs(difference).sum() / count), 0.0, by
    dssim, by_ssim = _dssim(x, target.color)
    return float(np.abs(difference).sum() / count), dssim / count, by - np.float32(share / count) * by_ssim


def _dssim(x: NDArray[Any], y: NDArray[Any]) -> tuple[float, NDArray[Any]]:
    """Sum of 1 - SSIM, and the gradient of the sum of SSIM by x."""

    def mean(image: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(cv2.boxFilter(image, -1, (WINDOW, WINDOW), borderType=cv2.BORDER_CONSTANT))

    mx, my = mean(x), mean(y)
    a, b = 2 * mx * my + np.float32(C1), 2 * (mean(x * y) - mx * my) + np.float32(C2)
    c = mx * mx + my * my + np.float32(C1)
    d = mean(x * x) - mx * mx + mean(y * y) - my * my + np.float32(C2)
    ssim = a * b / (c * d)
    by_xy, by_xx = 2 * ssim / b, -ssim / d
    by_mx = 2 * my * ssim / a - 2 * mx * ssim / c - by_xy * my - 2 * by_xx * mx
    # The window is symmetric and black outside, so the filter is its own adjoint.
    return float((1 - ssim).sum(dtype=np.float64)), mean(by_mx) + 2 * x * mean(by_xx) + y * mean(by_xy)


def _matte(alpha: F32, target: Target, weight: float) -> tuple[float, F32]:
    """The matte's loss and the weighted gradient by the accumulated opacity."""
    d = alpha - target.matte
    size = np.abs(d)
    loss = np.where(size < SOFT, d * d / (2 * SOFT), size - SOFT / 2).sum(dtype=np.float64) / target.pixels
    by = np.float32(weight / target.pixels) * np.clip(d / np.float32(SOFT), -1, 1)
    return float(loss), by


def _distortion(images: F32, target: Target, weight: float, gradient: F32) -> float:
    """Distortion in m^2; adds the weighted gradient."""
    alpha, depth, square = images[6], images[7], images[8]
    k = np.float32(weight / target.pixels)
    if weight > 0:
        gradient[6] += k * square
        gradient[7] -= 2 * k * depth
        gradient[8] += k * alpha
    return float((alpha * square - depth * depth).sum(dtype=np.float64) / target.pixels)


def _geometry(
    images: F32, target: Target, weights: LossWeights, scale: tuple[float, float], gradient: F32
) -> tuple[float, float, float]:
    """Consistency, L_depth and L_normal; adds their weighted gradients. scale: reference depth and height, metres."""
    reference_z, height = scale
    alpha, view, m = images[6], target.view, target.pixels
    inverse = 1 / np.maximum(alpha, np.float32(_FAINT))
    mean = images[7] * inverse
    normal = np.ascontiguousarray(np.moveaxis(images[3:6], 0, -1))
    length = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), np.float32(1e-6))
    unit = normal / length
    solid = (alpha > SOLID) & (target.matte > INSIDE)
    edges = edge_weights(target.color, weights.sigma) if weights.normal > 0 else np.zeros(alpha.shape)
    z = (mean.astype(np.float64) + reference_z) / height
    record = Geometry(z, unit, solid, edges, view.fx, view.fy, view.cx, view.cy)
    numbers = (weights.consistency / m, weights.depth / m, weights.normal / m, weights.delta, weights.jump)
    by_z, by_unit = np.zeros(alpha.shape), np.zeros((*alpha.shape, 3))
    sums = geometry_losses(record, GeometryWeights(*numbers), by_z, by_unit)
    by_mean = by_z / height
    gradient[7] += by_mean * inverse
    gradient[6] -= by_mean * mean * inverse
    along = (by_unit * unit).sum(-1, keepdims=True)
    gradient[3:6] += np.moveaxis((by_unit - along * unit) / length, -1, 0)
    consistency, depth, normals = (float(value) / m for value in sums)
    return consistency, depth, normals
