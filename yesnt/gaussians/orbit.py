"""Cameras around a Gaussian field: a ring of views, views between given ones, and views from all sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.gaussians.field import GaussianField

F64 = NDArray[np.float64]

_AROUND = 24  # views from all sides
_FAR = 3.0  # their distance, in radii of the field
_SIDE = 256  # pixels of their pictures


def look_at(eye: F64, target: F64) -> F64:
    """`world_from_camera` [4, 4] of a camera at a point that looks at another, world Z up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def bounds(field: GaussianField) -> tuple[F64, float]:
    """Centre [3] and radius of a field, of its Gaussians with an opacity of at least 0.3, outliers left out."""
    shown = field.positions[field.opacities >= 0.3].astype(np.float64)
    points = shown if len(shown) else field.positions.astype(np.float64)
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)


def cameras_around(field: GaussianField) -> list[tuple[Camera, int | None]]:
    """Views from all sides that have the whole field in their pictures."""
    centre, radius = bounds(field)
    index = np.arange(_AROUND) + 0.5
    polar, turn = np.arccos(1 - 2 * index / _AROUND), np.pi * (1 + np.sqrt(5)) * index
    ways = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    focal = 0.5 * _SIDE * (_FAR - 1) / 1.2
    return [
        (
            Camera(
                _SIDE, _SIDE, focal, focal, _SIDE / 2, _SIDE / 2, _one(look_at(centre + _FAR * radius * way, centre))
            ),
            None,
        )
        for way in ways
    ]


def orbit(camera: Camera, frame: int | None, centre: F64, count: int) -> Camera:
    """A camera that turns once around the vertical through a point, in `count` frames numbered from 1.

    Frame 1 is where the given camera is at a frame; every view keeps its elevation, distance and lens.
    """
    start, lens = camera.pose(frame), camera.lens(frame)
    poses = {}
    for i in range(count):
        angle = 2 * np.pi * i / count
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        pose = np.eye(4)
        pose[:3, :3] = turn @ start[:3, :3]
        pose[:3, 3] = turn @ (start[:3, 3] - centre) + centre
        poses[i + 1] = pose
    return Camera(camera.width, camera.height, lens.fx, lens.fy, lens.cx, lens.cy, MappingProxyType(poses))


def between(stops: Sequence[tuple[Camera, int | None]], centre: F64, count: int) -> Camera:
    """A camera that moves from stop to stop in `count` frames numbered from 1, with the first stop's size and lens.

    Directions from the centre turn at an even rate between two stops (spherical interpolation), distances change
    linearly, and so does the angle by which a stop looks aside from the centre.
    """
    from scipy.spatial.transform import Rotation, Slerp

    first, lens = stops[0][0], stops[0][0].lens(stops[0][1])
    poses = [camera.pose(frame) for camera, frame in stops]
    times = np.arange(len(poses), dtype=np.float64)
    aside = [look_at(pose[:3, 3], centre)[:3, :3].T @ pose[:3, :3] for pose in poses]  # 1 where it looks at the centre
    turns = Slerp(times, Rotation.from_matrix(np.stack(aside)))
    made = {}
    for i, time in enumerate(np.linspace(0, len(poses) - 1, count)):
        k = min(int(time), len(poses) - 2)
        place = centre + _on_the_way(poses[k][:3, 3] - centre, poses[k + 1][:3, 3] - centre, time - k)
        pose = look_at(place, centre)
        pose[:3, :3] = pose[:3, :3] @ turns(time).as_matrix()
        made[i + 1] = pose
    return Camera(first.width, first.height, lens.fx, lens.fy, lens.cx, lens.cy, MappingProxyType(made))


def _on_the_way(a: F64, b: F64, share: float) -> F64:
    """Offset [3] between two offsets: direction turned by a share of the angle between them, length in between."""
    from scipy.spatial import geometric_slerp

    lengths = np.linalg.norm(a), np.linalg.norm(b)
    way = geometric_slerp(a / lengths[0], b / lengths[1], [share])[0]
    return np.asarray(way * ((1 - share) * lengths[0] + share * lengths[1]))


def _one(pose: F64) -> Mapping[int, F64]:
    return MappingProxyType({0: pose})
