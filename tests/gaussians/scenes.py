"""Small Gaussian fields and cameras."""

from __future__ import annotations

import numpy as np

from yesnt.core.camera import Camera
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.records import View


def random_field(count: int, degree: int = 1, seed: int = 0, thin: float = 0.2) -> GaussianField:
    """Gaussians within half a metre of the origin; one axis of each is shorter by the factor `thin`."""
    rng = np.random.default_rng(seed)
    scales = rng.uniform(0.05, 0.15, (count, 3)) * [1, 1, thin]
    rotations = rng.normal(size=(count, 4))
    harmonics = 0.4 * rng.normal(size=(count, (degree + 1) ** 2, 3))
    return GaussianField(
        rng.uniform(-0.4, 0.4, (count, 3)), np.log(scales),
        rotations / np.linalg.norm(rotations, axis=1, keepdims=True), rng.normal(size=count), harmonics,
    )  # fmt: skip


def one_gaussian(
    scales: tuple[float, float, float], opacity: float = 0.8, at: tuple[float, ...] = (0, 0, 0)
) -> GaussianField:
    """A single grey Gaussian with the world's axes."""
    logit = np.log(opacity / (1 - opacity))
    return GaussianField([at], np.log([scales]), [[1, 0, 0, 0]], [logit], np.zeros((1, 1, 3)))  # type: ignore[arg-type]


def look_at(eye: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """`world_from_camera` [4, 4] of a camera in OpenCV axes that looks at a point, world Z up."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    pose[:3, 3] = eye
    return pose


def camera_at(eye: tuple[float, float, float], size: tuple[int, int] = (24, 16), focal: float = 30.0) -> Camera:
    """A camera that looks at the origin; size is width and height."""
    return Camera(*size, focal, focal, size[0] / 2, size[1] / 2, {0: look_at(eye)})


def view_at(eye: tuple[float, float, float], size: tuple[int, int] = (24, 16), focal: float = 30.0) -> View:
    """The pinhole view of `camera_at`."""
    return View.of(camera_at(eye, size, focal))


def shell(count: int, radius: float = 0.3, logit: float = 3.0) -> GaussianField:
    """Thin grey discs that lie evenly on a sphere about the origin."""
    index = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * index / count), np.pi * (1 + np.sqrt(5)) * index
    normal = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], 1)
    quaternions = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)], 1)  # turn z to the normal
    spacing = np.sqrt(4 * np.pi * radius**2 / count)
    return GaussianField(
        radius * normal, np.log(np.tile([[0.6 * spacing, 0.6 * spacing, 0.06 * spacing]], (count, 1))),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), np.full(count, logit),
        np.zeros((count, 1, 3)),
    )  # fmt: skip
