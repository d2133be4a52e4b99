"""What the rasteriser takes and returns: pinhole views, settings and rendered images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError

SURFACE = 0.25
"""Opacity at the surface of a field, of which the depth of a view is the depth."""

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """A pinhole camera of one frame, or a window of it, in OpenCV axes; pixel centres at +0.5.

    Attributes:
        rotation: [3, 3] camera_from_world.
        position: [3] centre of projection, world metres.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels from the window's left and top edge.
        width, height: of the window, in pixels.
    """

    rotation: F64
    position: F64
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @classmethod
    def of(cls, camera: Camera, frame: int | None = None) -> View:
        """The view of a camera at a frame; None takes the only or the first pose.

        Raises:
            JobError: the lens distorts. The pictures of a capture are undistorted before the fit.
        """
        lens, pose = camera.lens(frame), camera.pose(frame)
        if lens.distortion.acts:
            raise JobError(
                f"A Gaussian field is rendered by pinhole cameras; this one has {lens.distortion.model} distortion",
                "camera, key distortion",
                'the model "none"',
                "render without distortion and distort the pictures afterwards",
            )
        rotation = np.ascontiguousarray(pose[:3, :3].T)
        return cls(rotation, pose[:3, 3].copy(), lens.fx, lens.fy, lens.cx, lens.cy, camera.width, camera.height)

    def window(self, left: int, top: int, width: int, height: int) -> View:
        """The same camera for a window of its picture."""
        return View(
            self.rotation, self.position, self.fx, self.fy, self.cx - left, self.cy - top, width, height
        )  # fmt: skip

    def halved(self) -> View:
        """The same camera with pixels twice as wide; width and height are even."""
        return View(
            self.rotation, self.position, self.fx / 2, self.fy / 2, self.cx / 2, self.cy / 2,
            self.width // 2, self.height // 2,
        )  # fmt: skip

    def rays(self) -> F64:
        """[H, W, 3] directions through pixel centres in camera axes, z = 1."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        return np.stack(np.broadcast_arrays(x[None, :], y[:, None], np.ones((1, 1))), axis=-1)


@dataclass(frozen=True)
class RenderSettings:
    """How a field is rendered.

    Attributes:
        near: planar z in metres; what lies nearer is skipped.
        level: opacity at the surface, in (0, 1); measured in docs/gaussians.md.
    """

    near: float = 0.05
    level: float = SURFACE


@dataclass(frozen=True)
class RenderedView:
    """Images of a view of H rows and W columns.

    Attributes:
        color: [H, W, 3] associated colour on black, in the field's colour space.
        alpha: [H, W] coverage in [0, 1].
        normal: [H, W, 3] unit normals in world axes, towards the camera; 0 where nothing is.
        median_z: [H, W] planar depth at which half the light is absorbed, metres; 0 on a miss (alpha of 0.5 or less).
        mean_z: [H, W] mean planar depth weighted by absorption, metres; 0 where nothing is.
        surface_z: [H, W] planar depth at which the opacity along the ray reaches the level of the settings, metres; 0
            on a miss.
        distortion: [H, W] sum over pairs of Gaussians of their weights and squared distance in z, m^2.
    """

    color: F32
    alpha: F32
    normal: F32
    median_z: F32
    mean_z: F32
    surface_z: F32
    distortion: F32
