"""Reads environment maps: radiance in linear Rec.709 or in a job's working space."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color_spaces import LIN_REC709, Conversion
from yesnt.core.shot import PlateInput
from yesnt.io.color_config import FROM_ENVIRONMENT, locate_config
from yesnt.io.color_statements import StatedSpaces, Statement
from yesnt.io.pictures.decode_color import to_scene_linear
from yesnt.io.pictures.image import read_headers
from yesnt.io.pictures.not_finite import refuse_not_finite
from yesnt.io.pictures.passes import ColorChannels, find_color
from yesnt.io.pictures.placed import read_display

AS_IT_IS = Conversion()
"""Linear Rec.709 that stays it."""


@dataclass(frozen=True)
class Radiance:
    """An env map as it lies in its file.

    Attributes:
        values: [h, w, 3] radiance, finite and >= 0.
        negative: how many negative values were set to 0.
        infinite: how many infinite values were set to the clamp.
    """

    values: NDArray[np.float32]
    negative: int = 0
    infinite: int = 0


def read_radiance(
    path: Path, conversion: Conversion = AS_IT_IS, clamp: float | None = None, layer: str | None = None
) -> Radiance:
    """An env map as it lies in its file.

    Args:
        path: of the map.
        conversion: of its colours.
        clamp: what infinite radiance becomes, in the file's units; None: it is refused.
        layer: that holds the map, or a part's name; None: the well-known one.

    Raises:
        JobError: not an RGB picture, or NaN or Inf in it.
    """
    stored = _stored(_channels(path, layer))
    infinite = np.isposinf(stored)
    if clamp is not None:
        stored = np.where(infinite, np.float32(clamp), stored)
    remedy = "mend this picture" if clamp is not None or not infinite.any() else "mend it, or set `clamp` for this map"
    refuse_not_finite(~np.isfinite(stored), str(path), "R, G, B", remedy)
    radiance = to_scene_linear(stored, conversion)
    negative = radiance < 0
    return Radiance(np.where(negative, 0, radiance), int(negative.sum()), int(infinite.sum()))


def read_map(path: Path) -> NDArray[np.float32]:
    """An env map [h, w, 3] as the file states its colours, in linear Rec.709; not cleaned.

    Raises:
        JobError: not an RGB picture, or it does not state a space that is known.
    """
    found = _channels(path)
    spaces = StatedSpaces(locate_config("", FROM_ENVIRONMENT))
    space = spaces.stated(Statement.of(found.color[0].header), "env map", path)
    return to_scene_linear(_stored(found), spaces.conversion(space, LIN_REC709))


def _channels(path: Path, layer: str | None = None) -> ColorChannels:
    return find_color(read_headers(path), PlateInput(path=str(path), layer=layer), "light")


def _stored(found: ColorChannels) -> NDArray[np.float32]:
    """Colour [h, w, 3] of the display window, as stored."""
    return np.stack(read_display(found.color), axis=-1)
