"""The volume that the cameras of a capture have in common: where a subject can stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera

F64 = NDArray[np.float64]

Posed = tuple[Camera, int | None]
"""A camera and what its `pose` takes."""

_POINTS = 40  # along each side of the box that is searched
_NEAR = 0.02  # share of the cameras' distance: nothing stands that close to a camera


@dataclass(frozen=True)
class Volume:
    """A box along the axes of the world.

    Attributes:
        low: [3] smallest coordinates, metres.
        high: [3] largest coordinates, metres.
    """

    low: F64
    high: F64


def common_volume(cameras: Sequence[Posed], least: int) -> Volume:
    """The box of all points that at least `least` cameras have in their picture.

    It is searched around the point that is nearest to all optical axes, as far as the farthest camera from there.

    Args:
        cameras: the cameras of one moment.
        least: how many must see a point.

    Raises:
        ValueError: there is no such point.
    """
    centre, reach = looked_at(cameras)
    side = np.linspace(-reach, reach, _POINTS)
    points = centre + np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    count = np.zeros(len(points), np.int64)
    for camera, pose in cameras:
        count += has_in_picture(camera, pose, points, _NEAR * reach)
    inside = points[count >= least]
    if not len(inside):
        raise ValueError(f"no point is in the pictures of {least} of {len(cameras)} cameras")
    margin = side[1] - side[0]
    return Volume(inside.min(axis=0) - margin, inside.max(axis=0) + margin)


def looked_at(cameras: Sequence[Posed]) -> tuple[F64, float]:
    """The point nearest to all optical axes, by least squares, and the largest distance of a camera from it.

    One camera, or parallel ones, have no such point: a weak pull towards what lies before them then keeps it finite.
    The order of the cameras does not change a bit of the result.
    """
    poses = sorted((camera.pose(pose) for camera, pose in cameras), key=lambda pose: pose.ravel().tolist())
    places, ways = np.stack([pose[:3, 3] for pose in poses]), np.stack([pose[:3, 2] for pose in poses])
    across = np.eye(3) - ways[:, :, None] * ways[:, None, :]
    pull = 1e-4 * len(cameras)
    system = across.sum(axis=0) + pull * np.eye(3)
    apart = float(np.linalg.norm(places - places.mean(axis=0), axis=-1).max())
    towards = places.mean(axis=0) + max(apart, 1.0) * ways.mean(axis=0)
    centre = np.linalg.solve(system, np.einsum("vij,vj->i", across, places) + pull * towards)
    return centre, float(np.linalg.norm(places - centre, axis=-1).max())


def has_in_picture(camera: Camera, pose: int | None, points: F64, near: float = 0.0) -> NDArray[np.bool_]:
    """Which points [N, 3] a camera has in its picture, farther away than `near` metres."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z = np.moveaxis(camera.project(points, pose), -1, 0)
        return np.asarray((z > near) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height))
