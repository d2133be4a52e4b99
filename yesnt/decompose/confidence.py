"""From the spread of the members to the weight of an observation (method.md section 3); no torch needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

LARGEST_STD = 0.5
"""The largest population standard deviation of a quantity in [0, 1]."""


DIVISOR = 1.5
"""What the spread is divided by for the temporal solve. method.md's 0.5 takes all weight from pixels whose members
disagree most, which then follow their neighbours: where a class is rarely found (metal), to the wrong side."""


def confidence(std: Float32, divisor: float = DIVISOR) -> Float32:
    """1 - clip(std / divisor, 0, 1), any shape."""
    return (1 - np.clip(std / divisor, 0, 1)).astype(np.float32)
