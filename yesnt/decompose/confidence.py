"""From the spread of the members to the weight of an observation (method.md section 3); no torch needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

LARGEST_STD = 0.5
"""The largest population standard deviation of a quantity in [0, 1]."""


DIVISOR = 1.5
"""Divisor of the spread for the temporal solve. The paper's 0.5 removes all weight from pixels whose members disagree
most; these then follow their neighbours, for a rare class (metal) to the wrong side (docs/temporal.md)."""


def confidence(std: Float32, divisor: float = DIVISOR) -> Float32:
    """1 - clip(std / divisor, 0, 1), any shape."""
    return (1 - np.clip(std / divisor, 0, 1)).astype(np.float32)
