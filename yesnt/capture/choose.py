"""Chooses the cameras that measure the materials of a frame: those that see the subject, spread over directions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.io.cameras import CalibratedCamera

Float = NDArray[np.floating]

LEAST_CAMERAS = 4
"""Cameras that must see the subject for `evidence: {use: auto}`; with fewer the model alone is as good."""

LEAST_SHARE = 0.05
"""Share of the subject's vertices that a camera must have in its picture."""

NEAR = 75.0
"""Angle to the delivered view, degrees, within which a camera sees much of what the plate shows."""

_SAME_PLACE = 0.01  # metres: the delivered view is a camera of the capture, whose picture is the plate
_SAME_WAY = 0.9999  # cosine between viewing directions, as above

_MOST_VERTICES = 2000  # of the subject that are projected


def cameras_that_see(
    cameras: Mapping[str, CalibratedCamera], frame: int, vertices: Float, where: str
) -> dict[str, CalibratedCamera]:
    """Cameras with enough of the subject in their picture, in the file's order.

    Args:
        cameras: of the capture.
        frame: frame number.
        vertices: [N, 3] of the subject, world metres.
        where: names the cameras' file in errors.

    Raises:
        JobError: a camera that moves has no pose for the frame.
    """
    few = vertices[:: max(1, len(vertices) // _MOST_VERTICES)]
    found = {}
    for name, one in cameras.items():
        if not one.still and frame not in one.camera.poses:
            raise JobError(
                f"Camera {name} of the capture has no pose for frame {frame}", where,
                "a pose for every frame that is measured, or `world_from_camera` of a camera at rest", "add it",
            )  # fmt: skip
        x, y, z = np.moveaxis(one.camera.project(few, one.pose_of(frame)), -1, 0)
        with np.errstate(invalid="ignore"):
            inside = (z > 0) & (x >= 0) & (y >= 0) & (x < one.camera.width) & (y < one.camera.height)
        if inside.mean() >= LEAST_SHARE:
            found[name] = one
    return found


def choose_cameras(
    cameras: Mapping[str, CalibratedCamera], plate: Camera, frame: int, centre: Float, most: int
) -> tuple[str, ...]:
    """At most `most` cameras, spread over elevation and azimuth.

    The delivered view is one direction already. Next is always the camera whose direction from the subject is farthest
    from all that are chosen: first among those within 75 degrees of the delivered view, then among the others, which
    see its rim and what lies behind. A camera that the plate itself was taken with is left out, so that its picture
    does not count twice.

    Args:
        cameras: that see the subject.
        plate: camera of the delivered view.
        frame: frame number.
        centre: [3] middle of the subject, world metres.
        most: largest number.
    """
    here = _direction(plate.position(frame), centre)
    ways = {
        name: _direction(one.camera.position(one.pose_of(frame)), centre)
        for name, one in cameras.items()
        if not _same_view(one, plate, frame)
    }
    chosen: dict[str, Float] = {}
    for near in (True, False):
        left = {name: way for name, way in ways.items() if (_angle(way, here) <= NEAR) == near}
        while left and len(chosen) < most:
            taken = [here, *chosen.values()]
            farthest = {name: min(_angle(way, other) for other in taken) for name, way in left.items()}
            name = max(farthest, key=lambda one: round(farthest[one], 6))
            chosen[name] = left.pop(name)
    return tuple(name for name in cameras if name in chosen)


def _direction(place: Float, centre: Float) -> Float:
    """Unit direction from the subject to a place."""
    way = np.asarray(place, float) - centre
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def _angle(one: Float, other: Float) -> float:
    """Angle between unit vectors, degrees."""
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def _same_view(one: CalibratedCamera, plate: Camera, frame: int) -> bool:
    pose, own = one.camera.pose(one.pose_of(frame)), plate.pose(frame)
    near = float(np.linalg.norm(pose[:3, 3] - own[:3, 3])) < _SAME_PLACE
    return near and float(pose[:3, 2] @ own[:3, 2]) > _SAME_WAY
