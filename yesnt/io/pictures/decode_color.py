"""The one place where the colour of a picture becomes scene-linear, in linear Rec.709 or the working space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color_spaces import Conversion
from yesnt.io.color_config import convert

F32 = NDArray[np.float32]


def to_scene_linear(encoded: F32, conversion: Conversion) -> F32:
    """Straight colour [..., 3] as a file encodes it, to the conversion's target.

    Args:
        encoded: straight (not multiplied by coverage) values as stored.
        conversion: of the job, which has compared it with what the file says (io/job_colors.py).
    """
    return convert(encoded, conversion)
