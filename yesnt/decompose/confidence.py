"""Converts the spread of members to the data weight of the temporal solve (docs/method.md section 3). NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

LARGEST_STD = 0.5
"""Largest possible population standard deviation of a quantity in [0, 1]."""


DIVISOR = 1.5
"""Divisor of the standard deviation. The paper's 0.5 gives weight 0 to pixels whose members disagree most. These then
follow their neighbours, which is wrong where a material is rarely detected (metal) (docs/method.md section 3).
"""


def confidence(std: Float32, divisor: float = DIVISOR) -> Float32:
    """Returns the confidence 1 - clip(std / divisor, 0, 1).

    Args:
        std: population standard deviation of the members, any shape.
        divisor: standard deviation at which the confidence is 0.

    Returns:
        Confidence in [0, 1], same shape, float32.
    """
    return (1 - np.clip(std / divisor, 0, 1)).astype(np.float32)
