"""Renders a Gaussian opacity field for a camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from yesnt.core.camera import Camera
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.records import SURFACE, RenderedView, RenderSettings, View

if TYPE_CHECKING:
    from yesnt.gaussians.rasterise import Raster


def render(
    field: GaussianField, camera: Camera | View, frame: int | None = None, settings: RenderSettings | None = None
) -> RenderedView:
    """Colour, coverage, normals and depth of a field as a camera sees it.

    The bits do not depend on the number of threads. reference.py is the same in NumPy.

    Args:
        field: the Gaussians.
        camera: a camera, or a pinhole view of it (`View.window` renders a part of a picture).
        frame: frame of the camera; None takes the only or the first pose.
        settings: near plane and level of the surface.

    Raises:
        JobError: the camera's lens distorts, or it has no pose for the frame.
    """
    from yesnt.gaussians.rasterise import arrays_of, pinhole_of, rasterise

    view = camera if isinstance(camera, View) else View.of(camera, frame)
    middle = field.positions.mean(axis=0, dtype=np.float64) if field.count else np.zeros(3)
    settings = settings or RenderSettings()
    raster = rasterise(arrays_of(field), pinhole_of(view, middle, settings.near))
    return rendered_view(raster, view, settings.level)


def rendered_view(raster: Raster, view: View, level: float = SURFACE) -> RenderedView:
    """The images of a forward pass for a user: associated colour, unit normals in the world, depths in metres."""
    from yesnt.gaussians.surface_depth import surface_depth

    color, normal, alpha, depth, square, median = np.split(raster.images[:10], [3, 6, 7, 8, 9])
    covered = alpha > 0
    world = np.moveaxis(normal, 0, -1) @ view.rotation.astype(np.float32)
    length = np.linalg.norm(world, axis=-1, keepdims=True)
    mean = depth / np.where(covered, alpha, 1) + np.float32(raster.pinhole.reference_z)
    return RenderedView(
        np.ascontiguousarray(np.moveaxis(color, 0, -1)),
        alpha[0].copy(),
        np.asarray(world / np.where(length > 0, length, 1), np.float32),
        median[0].copy(),
        np.where(covered, mean, np.float32(0))[0],
        surface_depth(raster.gaussians, raster.projected, raster.lists, raster.pinhole, level),
        np.maximum(alpha * square - depth * depth, 0)[0],
    )
