"""What the temporal stages observe of a frame: the ensemble's estimate, or what cameras measured, with corrections."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.planning.stages import CORRECT, DECOMPOSE, EVIDENCE
from yesnt.planning.task_records import Gaps
from yesnt.tasks.workspace import Workspace

Float32 = NDArray[np.float32]


def observed(space: Workspace[Any], gaps: Gaps, frame: int) -> Float32:
    """Mean of the ensemble [2, H, W]; 0.5 for a frame without a decomposition, whose confidence is 0."""
    if frame in gaps.absent:
        return np.full((2, space.job.height, space.job.width), 0.5, np.float32)
    if space.job.shot.corrected:
        return space.read(CORRECT, "corrected", frame)
    return estimate(space, frame)[0]


def spread(space: Workspace[Any], frame: int) -> Float32:
    """Standard deviation of the ensemble [2, H, W]; 0 where the job gives the value."""
    if space.job.shot.corrected:
        return space.read(CORRECT, "corrected_spread", frame)
    return estimate(space, frame)[1]


def estimate(space: Workspace[Any], frame: int) -> tuple[Float32, Float32]:
    """Materials and their standard deviation [2, H, W] before corrections: measured by cameras, or of the ensemble."""
    if measured(space):
        return space.read(EVIDENCE, "measured", frame), space.read(EVIDENCE, "measured_spread", frame)
    return space.read(DECOMPOSE, "observed", frame), space.read(DECOMPOSE, "spread", frame)


def measured(space: Workspace[Any]) -> bool:
    """Whether the capture's cameras measure the materials of the shot, as the key of the task says."""
    return EVIDENCE.label in space.node.fields["upstream"]


def certain(space: Workspace[Any], frame: int) -> Float32 | float:
    """The share of each value that the job gives [2, H, W]: there no neighbour lowers its confidence."""
    return space.read(CORRECT, "certain", frame) if space.job.shot.corrected else 0.0
