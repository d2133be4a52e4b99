"""What the light on the set depends on: its pixels, the subject, and a mesh that it may be itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.points import Pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.surroundings import Surroundings
from yesnt.scene.pixel_parts import PixelParts
from yesnt.scene.subject import Subject

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class SetScene:
    """What is around the set's pixels.

    Attributes:
        subject: the subject.
        surroundings: the set where it may occlude itself, a mesh; None for a plane.
        offset: distance of the rays' origins from the set, metres.
    """

    subject: Subject
    surroundings: Surroundings | None
    offset: float

    @cached_property
    def joined(self) -> ProxyScene:
        """What rays may hit: the subject, and the set behind it in the list of triangles."""
        mesh = self.subject.mesh
        return mesh if self.surroundings is None else self.surroundings.around(mesh)


@dataclass(frozen=True)
class SetView:
    """P pixels of the set as a camera sees them.

    Attributes:
        pixels: of one material.
        color: [3] their base colour.
        parts: their parts.
    """

    pixels: Pixels
    color: F32
    parts: PixelParts
