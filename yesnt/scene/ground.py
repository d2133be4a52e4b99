"""The ground under the subject: its height over a whole shot, and a mesh of it for indirect light.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

SOLE = 0.0002
"""Share of a proxy's area below its lowest contact: 4 cm2 of a person, the tip of a toe. A stray vertex has less."""

STANCE = 0.1
"""Quantile of the frames' contacts that is the ground: in other frames the subject may be in the air."""

RINGS, SECTORS = 20, 32
"""Of the mesh of a ground plane: 1,248 triangles, about 10 cm wide where the subject moves."""


@dataclass(frozen=True)
class Ground:
    """A horizontal disc.

    Attributes:
        height: world z, metres.
        centre: x and y of its middle, metres.
        reach: largest distance of the subject from the middle in any frame, metres.
        radius: of the disc, metres.
    """

    height: float
    centre: tuple[float, float]
    reach: float
    radius: float

    def cover(self, points: F32) -> F32:
        """Coverage [P] in [0, 1] of the ground at points [P, 3] of its plane: it fades from half the radius on."""
        apart = np.hypot(points[:, 0] - self.centre[0], points[:, 1] - self.centre[1])
        t = np.clip(2 - 2 * apart / self.radius, 0, 1)
        return (t * t * (3 - 2 * t)).astype(np.float32)

    def mesh(self) -> tuple[F32, I32]:
        """Vertices [V, 3] and faces [G, 3], upwards: rings that are narrow where the subject moves."""
        t = np.arange(1, RINGS + 1) / RINGS
        near = min(self.reach + 0.5, 0.5 * self.radius)
        ring = near * t + (self.radius - near) * t**5
        angle = 2 * np.pi * np.arange(SECTORS) / SECTORS
        x = self.centre[0] + np.outer(ring, np.cos(angle)).reshape(-1)
        y = self.centre[1] + np.outer(ring, np.sin(angle)).reshape(-1)
        rim = np.stack([x, y, np.full_like(x, self.height)], axis=-1)
        vertices = np.concatenate([[[*self.centre, self.height]], rim]).astype(np.float32)
        turn, after = np.arange(SECTORS), (np.arange(SECTORS) + 1) % SECTORS
        faces = [np.stack([0 * turn, 1 + turn, 1 + after], axis=-1)]
        for first in range(1, 1 + (RINGS - 1) * SECTORS, SECTORS):
            inner, outer = first, first + SECTORS
            faces.append(np.stack([inner + turn, outer + turn, outer + after], axis=-1))
            faces.append(np.stack([inner + turn, outer + after, inner + after], axis=-1))
        return vertices, np.concatenate(faces).astype(np.int32)


@dataclass(frozen=True)
class Stance:
    """Where the subject stands in one frame.

    Attributes:
        contact: world z of the lowest contact, metres.
        low: x and y of the lowest corner of its box, metres.
        high: x and y of the highest corner.
    """

    contact: float
    low: tuple[float, float]
    high: tuple[float, float]


def stance(vertices: F32, faces: I32) -> Stance:
    """The stance of a mesh [V, 3], [F, 3]: the height below which `SOLE` of its area lies.

    The area of a triangle counts half at its lowest vertex and half at its centre, so that one long triangle does not
    stand for all that it spans.
    """
    corners = vertices[faces].astype(np.float64)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    heights = np.concatenate([corners[..., 2].min(axis=1), corners[..., 2].mean(axis=1)])
    order = np.argsort(heights, kind="stable")
    below = np.cumsum(np.tile(0.5 * area, 2)[order])
    place = min(int(np.searchsorted(below, SOLE * below[-1])), len(order) - 1)
    (x0, y0), (x1, y1) = (edge(vertices[:, :2], axis=0).tolist() for edge in (np.min, np.max))
    return Stance(float(heights[order[place]]), (x0, y0), (x1, y1))


def fit_ground(stances: Sequence[Stance], height: float | None, radius: float) -> Ground:
    """The ground of a shot from the stances of all its frames.

    Args:
        stances: one a frame, at least one.
        height: world z, metres; None: the `STANCE` quantile of the contacts, so that neither frames in the air nor a
            stray proxy move it.
        radius: of the disc, metres.
    """
    low = np.min([s.low for s in stances], axis=0)
    high = np.max([s.high for s in stances], axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
    found = float(np.quantile([s.contact for s in stances], STANCE)) if height is None else height
    return Ground(found, (float(middle[0]), float(middle[1])), reach, max(radius, reach))
