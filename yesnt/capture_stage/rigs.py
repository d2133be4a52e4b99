"""Rigs of the virtual stage: the calibrated cameras of a capture, on circles about the subject."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from yesnt.capture_stage.cameras import Matrix, look_at


@dataclass(frozen=True)
class Ring:
    """Cameras at one elevation, degrees; azimuth 0 faces the subject, positive moves to its left.

    Attributes:
        elevation: of all of them.
        azimuths: of each.
    """

    elevation: float
    azimuths: tuple[float, ...]

    @classmethod
    def even(cls, count: int, elevation: float, first: float) -> Ring:
        """So many cameras all around."""
        return cls(elevation, tuple(first + 360.0 * i / count for i in range(count)))


@dataclass(frozen=True)
class Rig:
    """Cameras of a capture.

    Attributes:
        rings: cameras c00, c01, ... in this order.
        held_out: cameras h00, h01, ... that no method is given; they also have true z and normals.
        frames: that are recorded.
        mesh: whether the true surface of each moment is written.
        every: of the job file: every n-th frame of the shot is measured.
    """

    rings: tuple[Ring, ...]
    frames: tuple[int, ...]
    held_out: tuple[Ring, ...] = ()
    mesh: bool = False
    every: int = 1

    @property
    def cameras(self) -> dict[str, tuple[float, float]]:
        """Azimuth and elevation of every camera of the capture, degrees."""
        return dict(_named("c", self.rings))

    @property
    def held_out_cameras(self) -> dict[str, tuple[float, float]]:
        """Azimuth and elevation of every camera that is held out, degrees."""
        return dict(_named("h", self.held_out))


def _named(letter: str, rings: tuple[Ring, ...]) -> Iterator[tuple[str, tuple[float, float]]]:
    ways = [(azimuth, ring.elevation) for ring in rings for azimuth in ring.azimuths]
    yield from ((f"{letter}{i:02d}", way) for i, way in enumerate(ways))


def pose_on_sphere(azimuth: float, elevation: float, distance: float, middle: float) -> Matrix:
    """`world_from_camera` [4, 4] of a camera that looks at (0, 0, middle); angles in degrees, lengths in metres."""
    turn, lift = np.radians(azimuth), np.radians(elevation)
    offset = np.array([np.cos(lift) * np.sin(turn), -np.cos(lift) * np.cos(turn), np.sin(lift)])
    target = np.array([0.0, 0.0, middle])
    return look_at(target + distance * offset, target)


SIXTEEN = (Ring.even(8, 10, 18), Ring.even(4, 45, 40), Ring.even(4, -25, 63))
"""16 cameras all around, half of them at 10 degrees, the others above and below between them."""

TWELVE = (Ring.even(6, 10, 10), Ring.even(3, 45, 40), Ring.even(3, -25, -20))
"""12 cameras all around."""

TWENTY_FOUR = (Ring.even(12, 10, 0), Ring.even(6, 45, 15), Ring.even(6, -25, 45))
"""24 cameras all around."""

BETWEEN = (Ring.even(3, 22, 22), Ring.even(3, -6, 80))
"""6 cameras between those of `TWENTY_FOUR`."""

FRONT = (Ring(10, (-80, -35, 25, 70)), Ring(45, (-30, 45)), Ring(-25, (-50, 30)))
"""8 cameras before the subject: the embedded shot is small, so they all see what its plate shows."""
