"""Task of the confidence: data weights of one chunk. Frames are read one at a time, few are held."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.confidence import confidence
from yesnt.planning.stages import FLOW
from yesnt.planning.task_records import ConfidenceTask
from yesnt.tasks.memory import trim_memory
from yesnt.tasks.observations import certain, observed, spread
from yesnt.tasks.workspace import Workspace
from yesnt.temporal.outliers import FrameConsistency, OutlierSettings, frame_consistency
from yesnt.temporal.tracks import ObservedFrame

Float32 = NDArray[np.float32]


def weigh_frames(space: Workspace[ConfidenceTask]) -> None:
    """Commits the confidence [2, H, W] of one chunk: 1 - spread, less where a frame contradicts its neighbours."""
    trim_memory()  # once a chunk is enough to keep a long shot's memory flat
    pending = set(space.pending())
    if not space.job.shot.temporal.robust:
        for frame in pending:
            space.commit(frame, {"confidence": _ensemble_confidence(space, frame)})
        return
    loaded = space.task.loaded
    frames = space.job.frames[loaded.start : loaded.stop]
    weights = frame_consistency(lambda t: _read(space, frames, t), len(frames))
    for frame, found in _timed(space, frames, weights):
        if frame in pending:
            _commit(space, frame, found)


def _timed(
    space: Workspace[ConfidenceTask], frames: tuple[int, ...], weights: Iterator[FrameConsistency]
) -> Iterator[tuple[int, FrameConsistency]]:
    """Frames with their weights; the time to find each counts as kernel time, without the readings inside."""
    for frame in frames:
        with space.kernel():
            found = next(weights)
        yield frame, found


def _commit(space: Workspace[ConfidenceTask], frame: int, found: FrameConsistency) -> None:
    given = 0.0 if frame in space.task.gaps.absent else certain(space, frame)
    with space.kernel():
        values = np.maximum(_ensemble_confidence(space, frame) * found.weight, given)
    facts = {
        "inconsistent": [frame] if found.ratio > OutlierSettings().limit else [],
        "ratio": found.ratio, "downweighted": found.downweighted,
    }  # fmt: skip
    space.commit(frame, {"confidence": values}, facts=facts)


def _read(space: Workspace[ConfidenceTask], frames: tuple[int, ...], position: int) -> ObservedFrame:
    """A frame with its flow to the next: none for the last one, no valid pixel where the flow is missing."""
    frame = frames[position]
    matte, values = space.matte(frame), observed(space, space.task.gaps, frame)
    if position == len(frames) - 1:
        return ObservedFrame(values, matte, None, None)
    if frame in space.task.gaps.unlinked:
        flow, validity = np.zeros((*matte.shape, 2), np.float32), np.zeros(matte.shape, np.float32)
        return ObservedFrame(values, matte, flow, validity)
    flow = space.read(FLOW, "flow", frame).transpose(1, 2, 0)
    return ObservedFrame(values, matte, flow, space.read(FLOW, "validity", frame)[0])


def _ensemble_confidence(space: Workspace[ConfidenceTask], frame: int) -> Float32:
    """1 - spread of the ensemble [2, H, W]; 0 for a frame without a decomposition."""
    if frame in space.task.gaps.absent:
        return np.zeros((2, space.job.height, space.job.width), np.float32)
    return confidence(spread(space, frame))
