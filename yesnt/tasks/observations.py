"""What the decomposition measured of a frame, as the temporal stages read it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.planning.stages import DECOMPOSE
from yesnt.planning.task_records import Gaps
from yesnt.tasks.workspace import Workspace


def observed(space: Workspace[Any], gaps: Gaps, frame: int) -> NDArray[np.float32]:
    """Mean of the ensemble [2, H, W]; 0.5 for a frame without a decomposition, whose confidence is 0."""
    if frame in gaps.absent:
        return np.full((2, space.job.height, space.job.width), 0.5, np.float32)
    return space.read(DECOMPOSE, "observed", frame)
