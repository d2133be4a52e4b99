"""Rendering of a Gaussian opacity field as method.md section 2 states it: float64, every Gaussian at every pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.harmonics import colors
from yesnt.gaussians.records import RenderedView, RenderSettings, View

F64 = NDArray[np.float64]

ALPHA_MAX = 0.99
"""Largest opacity of a Gaussian at a pixel, so that the transmittance stays positive and has a gradient."""

ALPHA_MIN = 1 / 255
"""A Gaussian of less opacity at a pixel is skipped there."""

TRANSMITTANCE_MIN = 1e-4
"""A pixel takes no further Gaussian once so little light passes."""


@dataclass(frozen=True)
class Sums:
    """What front-to-back compositing accumulates per pixel, each [H, W] or [H, W, 3].

    Attributes:
        color, normal: weighted colours and normals (camera axes).
        alpha: sum of weights.
        z, z_squared: weighted planar depth and its square, metres.
        median_z: planar depth of the Gaussian at which the transmittance crosses 0.5; 0 on a miss.
        transmittance: light that passes all Gaussians.
    """

    color: F64
    normal: F64
    alpha: F64
    z: F64
    z_squared: F64
    median_z: F64
    transmittance: F64


def ray_maximum(rays: F64, center: F64, precision: F64) -> tuple[F64, F64]:
    """Planar depth t* of the largest response along rays [..., 3] and that response E, both [...].

    With r the ray and M the precision about the centre b: A = r'Mr, B = -2 r'Mb, C = b'Mb, t* = -B / (2A),
    E = exp(-(C - B^2 / (4A)) / 2).
    """
    a = np.einsum("...i,ij,...j->...", rays, precision, rays)
    b = -2 * rays @ precision @ center
    c = center @ precision @ center
    return -b / (2 * a), np.exp(-0.5 * np.maximum(c - b * b / (4 * a), 0))


def depth_order(field: GaussianField, view: View, near: float) -> tuple[NDArray[np.intp], F64]:
    """Indices of the Gaussians whose centre lies behind the near plane, nearest first, and all centres [N, 3].

    Centres are in camera axes. Equal depths keep the order of the field.
    """
    centers = (field.positions.astype(np.float64) - view.position) @ view.rotation.T
    order = np.argsort(centers[:, 2].astype(np.float32), kind="stable")
    return order[centers[order, 2] >= near], centers


def gaussians_along_rays(field: GaussianField, view: View, near: float) -> Iterator[tuple[int, F64, F64, F64]]:
    """Of each Gaussian, nearest first: its index, opacity [H, W], t* [H, W] and normal [3] in camera axes."""
    rays, opacities = view.rays(), field.opacities
    order, centers = depth_order(field, view, near)
    axes = view.rotation @ field.axes
    precisions = np.einsum("nij,nj,nkj->nik", axes, 1 / field.variances, axes)
    for i in order:
        t, response = ray_maximum(rays, centers[i], precisions[i])
        alpha = np.minimum(ALPHA_MAX, opacities[i] * response)
        alpha = np.where((alpha < ALPHA_MIN) | (t < near), 0, alpha)
        across = precisions[i] @ centers[i]  # the normal of the isosurface where the ray through the centre meets it
        yield int(i), alpha, t, -across / np.linalg.norm(across)


def composite(field: GaussianField, view: View, near: float) -> Sums:
    """Composites all Gaussians front to back."""
    shape = (view.height, view.width)
    color, normal = np.zeros((*shape, 3)), np.zeros((*shape, 3))
    alpha_sum, z, z_squared, median_z = (np.zeros(shape) for _ in range(4))
    passed = np.ones(shape)
    offset = field.positions.astype(np.float64) - view.position
    seen = colors(field.harmonics, offset / np.linalg.norm(offset, axis=1, keepdims=True))
    for i, alpha, t, own_normal in gaussians_along_rays(field, view, near):
        alpha = np.where(passed > TRANSMITTANCE_MIN, alpha, 0)
        weight = alpha * passed
        color += weight[..., None] * seen[i]
        normal += weight[..., None] * own_normal
        alpha_sum += weight
        z += weight * t
        z_squared += weight * t * t
        crosses = (passed > 0.5) & (passed - weight <= 0.5)
        median_z = np.where(crosses, t, median_z)
        passed = passed - weight
    return Sums(color, normal, alpha_sum, z, z_squared, median_z, passed)


def render_reference(field: GaussianField, view: View, settings: RenderSettings | None = None) -> RenderedView:
    """The images of a view (`RenderedView`), without tiles and in float64."""
    settings = settings or RenderSettings()
    sums = composite(field, view, settings.near)
    covered = sums.alpha > 0
    safe = np.where(covered, sums.alpha, 1)
    world = sums.normal @ view.rotation
    length = np.linalg.norm(world, axis=-1, keepdims=True)
    images = (
        sums.color, sums.alpha, world / np.where(length > 0, length, 1), sums.median_z,
        np.where(covered, sums.z / safe, 0), surface_z(field, view, settings),
        np.maximum(sums.alpha * sums.z_squared - sums.z**2, 0),
    )  # fmt: skip
    return RenderedView(*(np.asarray(image, np.float32) for image in images))


def surface_z(field: GaussianField, view: View, settings: RenderSettings) -> F64:
    """Planar depth [H, W] at which 1 - prod(1 - alpha(t)) reaches the level of the settings; 0 where it never does.

    A Gaussian with opacity o, distance q from the ray and precision A along it has
    alpha(t) = o exp(-(q + A max(t* - t, 0)^2) / 2).
    """
    rays, (order, centers) = view.rays(), depth_order(field, view, settings.near)
    axes = view.rotation @ field.axes
    precisions = np.einsum("nij,nj,nkj->nik", axes, 1 / field.variances, axes)
    nearest = [ray_maximum(rays, centers[i], precisions[i]) for i in order]
    along = [np.einsum("...i,ij,...j->...", rays, precisions[i], rays) for i in order]

    def opacity(t: F64) -> F64:
        through = np.ones(t.shape)
        for i, (peak, response), a in zip(order, nearest, along, strict=True):
            alpha = field.opacities[i] * response * np.exp(-0.5 * a * np.maximum(peak - t, 0) ** 2)
            through *= 1 - np.where((alpha < ALPHA_MIN) | (peak < settings.near), 0, np.minimum(alpha, ALPHA_MAX))
        return 1 - through

    far = np.max([peak for peak, _ in nearest], axis=0, initial=settings.near) * np.ones(rays.shape[:2])
    near, reached = np.zeros_like(far), opacity(far) >= settings.level
    for _ in range(48):
        middle = 0.5 * (near + far)
        short = opacity(middle) < settings.level
        near, far = np.where(short, middle, near), np.where(short, far, middle)
    return np.where(reached, far, 0)
