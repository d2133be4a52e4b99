"""The one place where the colour of a picture becomes scene-linear Rec.709."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_decode
from yesnt.io.pictures.image import ImageHeader

F32 = NDArray[np.float32]


def to_scene_linear(encoded: F32, colorspace: str, header: ImageHeader) -> F32:
    """Straight colour [..., 3] as a file encodes it, to scene-linear Rec.709.

    Args:
        encoded: straight (not multiplied by coverage) values as stored, >= 0.
        colorspace: what the job says of them.
        header: of the file; what it says of its colour.
    """
    return srgb_decode(encoded).astype(np.float32) if colorspace == "srgb" else encoded
