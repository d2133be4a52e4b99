"""What the temporal stages observe of a frame: the decomposition, or its corrected form where the job corrects it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.planning.stages import CORRECT, DECOMPOSE
from yesnt.planning.task_records import Gaps
from yesnt.tasks.workspace import Workspace

Float32 = NDArray[np.float32]


def observed(space: Workspace[Any], gaps: Gaps, frame: int) -> Float32:
    """Mean of the ensemble [2, H, W]; 0.5 for a frame without a decomposition, whose confidence is 0."""
    if frame in gaps.absent:
        return np.full((2, space.job.height, space.job.width), 0.5, np.float32)
    if space.job.shot.corrected:
        return space.read(CORRECT, "corrected", frame)
    return space.read(DECOMPOSE, "observed", frame)


def spread(space: Workspace[Any], frame: int) -> Float32:
    """Standard deviation of the ensemble [2, H, W]; 0 where the job gives the value."""
    if space.job.shot.corrected:
        return space.read(CORRECT, "corrected_spread", frame)
    return space.read(DECOMPOSE, "spread", frame)


def certain(space: Workspace[Any], frame: int) -> Float32 | float:
    """The share of each value that the job gives [2, H, W]: there no neighbour lowers its confidence."""
    return space.read(CORRECT, "certain", frame) if space.job.shot.corrected else 0.0
