"""The temporal solve of one chunk in one sweep: loads what temporal/blocks.py asks for, solves, commits the core."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt import settings as of
from yesnt.io.capture import read_matte
from yesnt.temporal import solve as solve_whole
from yesnt.temporal.blocks import Border, border_mask, largest_change, solve_block
from yesnt.workspace import Workspace

Float32 = NDArray[np.float32]

SETTLED = 0.1
"""A sweep is skipped if the one before changed nothing around it by more than this share of the tolerance."""


def solve(space: Workspace) -> None:
    """Commits the core frames of one chunk."""
    job, node = space.job, space.node
    block = node.arguments["block"]
    start, stop = node.arguments["loaded"]
    value, facts = _value(space, job.frames[start:stop])
    pending = set(space.pending())
    for position in block.core:
        if job.frames[position] in pending:
            space.commit(job.frames[position], {_array(node.stage): value[:, position - start]}, facts=facts)


def _value(space: Workspace, frames: tuple[int, ...]) -> tuple[Float32, dict[str, float]]:
    """The solved material [2, T, H, W] of the loaded frames, and what the solver says of itself."""
    observed, confidence = _observations(space, frames)
    if not space.job.shot.temporal.enabled:
        return observed, {}
    previous = _previous(space, frames, "previous")
    before = _previous(space, frames, "before_previous")
    tolerance = space.job.shot.temporal.tolerance
    if previous is not None and before is not None and largest_change(previous, before) < SETTLED * tolerance:
        return previous, {"skipped": 1}
    return _solve(space, frames, observed, confidence, previous)


def _solve(
    space: Workspace, frames: tuple[int, ...], observed: Float32, confidence: Float32, previous: Float32 | None
) -> tuple[Float32, dict[str, float]]:
    temporal, params = space.job.shot.temporal, of.energy_params(space.job.shot)
    matte = np.stack([read_matte(space.job, frame) > 0.5 for frame in frames])
    flow, validity = _links(space, frames)
    with space.kernel():
        if temporal.method == "adam":
            solution = solve_whole(
                observed, confidence, flow, validity, params, matte, temporal.tolerance, method="adam"
            )  # fmt: skip
        else:
            border = None
            if previous is not None:
                border = Border(previous, border_mask(matte.shape, _border_frames(space)))
            solution = solve_block(
                observed, confidence, flow, validity, params, matte, border, SETTLED * temporal.tolerance
            )  # fmt: skip
    stats = solution.stats
    return solution.value, {"iterations": stats.iterations, "gap": stats.gap, "pixels": stats.pixels}


def _observations(space: Workspace, frames: tuple[int, ...]) -> tuple[Float32, Float32]:
    """Mean and confidence [2, T, H, W]; a frame without a decomposition has confidence 0."""
    from yesnt.decompose.ensemble import confidence

    absent = space.node.arguments["absent"]
    shape = (2, space.job.height, space.job.width)
    means, weights = [], []
    for frame in frames:
        gone = frame in absent
        means.append(np.full(shape, 0.5, np.float32) if gone else space.read("decompose", "observed", frame))
        weights.append(np.zeros(shape, np.float32) if gone else confidence(space.read("decompose", "spread", frame)))
    return np.stack(means, axis=1), np.stack(weights, axis=1)


def _links(space: Workspace, frames: tuple[int, ...]) -> tuple[Float32, Float32]:
    """Flow [T-1, H, W, 2] and validity [T-1, H, W]; a pair without flow has validity 0."""
    height, width = space.job.height, space.job.width
    flow = np.zeros((len(frames) - 1, height, width, 2), np.float32)
    validity = np.zeros((len(frames) - 1, height, width), np.float32)
    for i, frame in enumerate(frames[:-1]):
        if frame not in space.node.arguments["unlinked"]:
            flow[i] = space.read("flow", "flow", frame).transpose(1, 2, 0)
            validity[i] = space.read("flow", "validity", frame)[0]
    return flow, validity


def _previous(space: Workspace, frames: tuple[int, ...], which: str) -> Float32 | None:
    stage = space.node.arguments[which]
    if stage is None:
        return None
    return np.stack([space.read(stage, _array(stage), frame) for frame in frames], axis=1)


def _border_frames(space: Workspace) -> tuple[int, int]:
    """How many loaded frames before and after the block's outer span are its neighbours'."""
    outer = space.node.arguments["block"].outer
    start, stop = space.node.arguments["loaded"]
    return outer.start - start, stop - outer.stop


def _array(stage: str) -> str:
    return "material" if stage == "solve" else stage
