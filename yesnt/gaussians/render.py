"""Renders a Gaussian opacity field for a camera."""

from __future__ import annotations

from yesnt.core.camera import Camera
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.records import RenderedView, RenderSettings, View
from yesnt.gaussians.reference import render_reference


def render(
    field: GaussianField, camera: Camera | View, frame: int | None = None, settings: RenderSettings | None = None
) -> RenderedView:
    """Colour, coverage, normals and depth of a field as a camera sees it.

    Args:
        field: the Gaussians.
        camera: a camera, or a pinhole view of it (`View.window` renders a part of a picture).
        frame: frame of the camera; None takes the only or the first pose.
        settings: near plane.

    Raises:
        JobError: the camera's lens distorts, or it has no pose for the frame.
    """
    view = camera if isinstance(camera, View) else View.of(camera, frame)
    return render_reference(field, view, settings)
