"""How far the frames of one chunk are trusted, as a task: frames are read one at a time, few are held."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.confidence import confidence
from yesnt.tasks.solve import observed
from yesnt.tasks.workspace import Workspace, trim_memory
from yesnt.temporal.outliers import FrameConsistency, OutlierSettings, frame_consistency
from yesnt.temporal.tracks import ObservedFrame

Float32 = NDArray[np.float32]


def trust(space: Workspace) -> None:
    """Commits the confidence of one chunk: 1 - sigma, less where a frame contradicts its neighbours."""
    trim_memory()  # once a chunk is enough to keep a long shot's memory flat
    pending = set(space.pending())
    if not space.job.shot.temporal.robust:
        for frame in pending:
            space.commit(frame, {"confidence": _ensemble_confidence(space, frame)})
        return
    start, stop = space.node.arguments["loaded"]
    frames = space.job.frames[start:stop]
    core = set(space.node.frames)
    limit = OutlierSettings().limit
    consistencies = frame_consistency(lambda t: _read(space, frames, t), len(frames))
    for frame in frames:
        with space.kernel():  # it reads frames as it goes; those are not counted
            found = next(consistencies)
        if frame in core and frame in pending:
            _commit(space, frame, found, limit)


def _commit(space: Workspace, frame: int, found: FrameConsistency, limit: float) -> None:
    with space.kernel():
        values = _ensemble_confidence(space, frame) * found.weight
    facts = {
        "inconsistent": [frame] if found.ratio > limit else [],
        "ratio": found.ratio, "downweighted": found.downweighted,
    }  # fmt: skip
    space.commit(frame, {"confidence": values}, facts=facts)


def _read(space: Workspace, frames: tuple[int, ...], position: int) -> ObservedFrame:
    frame = frames[position]
    matte = space.matte(frame)
    if position == len(frames) - 1:
        return ObservedFrame(observed(space, frame), matte, None, None)
    if frame in space.node.arguments["unlinked"]:
        none = np.zeros(matte.shape, np.float32)
        return ObservedFrame(observed(space, frame), matte, np.zeros((*matte.shape, 2), np.float32), none)
    flow = space.read("flow", "flow", frame).transpose(1, 2, 0)
    return ObservedFrame(observed(space, frame), matte, flow, space.read("flow", "validity", frame)[0])


def _ensemble_confidence(space: Workspace, frame: int) -> Float32:
    """1 - sigma of the members [2, H, W]; 0 for a frame without a decomposition."""
    if frame in space.node.arguments["absent"]:
        return np.zeros((2, space.job.height, space.job.width), np.float32)
    return confidence(space.read("decompose", "spread", frame))
