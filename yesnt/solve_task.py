"""Tasks on chunks of frames: how far each frame is trusted, and the temporal solve (see temporal/blocks.py)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt import settings as of
from yesnt.decompose.confidence import confidence
from yesnt.temporal import Border, border_mask, largest_change, robust_confidence, solve_block
from yesnt.temporal import solve as solve_whole
from yesnt.workspace import Workspace

Float32 = NDArray[np.float32]

SETTLED = 0.1
"""A chunk is left as it is if its border moved by less than this share of the tolerance since it was solved last."""


def trust(space: Workspace) -> None:
    """Commits the confidence of one chunk: 1 - sigma, less where a frame contradicts its neighbours."""
    frames = _loaded(space)
    observed, confidence = _observed(space, frames), _ensemble_confidence(space, frames)
    facts: dict[str, Any] = {}
    if space.job.shot.temporal.robust:
        flow, validity = _links(space, frames)
        matte = _mattes(space, frames)
        with space.kernel():
            confidence, report = robust_confidence(observed, confidence, flow, validity, matte)
        core = set(space.node.frames)
        facts["inconsistent"] = [frames[i] for i in report.frames if frames[i] in core]
    _commit_core(space, "confidence", confidence, facts)


def solve(space: Workspace) -> None:
    """Commits the material of one chunk after one sweep."""
    value, facts = _value(space, _loaded(space))
    _commit_core(space, _array(space.node.stage), value, facts)


def _commit_core(space: Workspace, array: str, values: Float32, facts: dict[str, Any]) -> None:
    start, pending = space.node.arguments["loaded"][0], set(space.pending())
    for position in space.node.arguments["block"].core:
        frame = space.job.frames[position]
        if frame in pending:
            space.commit(frame, {array: values[:, position - start]}, facts=facts)


def _loaded(space: Workspace) -> tuple[int, ...]:
    start, stop = space.node.arguments["loaded"]
    return space.job.frames[start:stop]


def _value(space: Workspace, frames: tuple[int, ...]) -> tuple[Float32, dict[str, Any]]:
    """The solved material [2, T, H, W] of the loaded frames, and what the solver says of itself."""
    observed = _observed(space, frames)
    if not space.job.shot.temporal.enabled:
        return observed, {}
    now = _known(space, frames)
    if now is None:
        confidence = np.stack([space.read("trust", "confidence", frame) for frame in frames], axis=1)
        return _solve(space, frames, observed, confidence, None)
    seam = _seam(space, frames, now)
    if seam < SETTLED * space.job.shot.temporal.tolerance:
        return now, {"seam": seam, "skipped": True}
    confidence = np.stack([space.read("trust", "confidence", frame) for frame in frames], axis=1)
    value, facts = _solve(space, frames, observed, confidence, now)
    return value, facts | {"seam": min(seam, 1.0)}


def _seam(space: Workspace, frames: tuple[int, ...], now: Float32) -> float:
    """How far the border has moved since this chunk was last solved; infinite if it has met no border yet."""
    then: dict[int, str] = space.node.arguments["then"]
    if not then:
        return np.inf
    moved = [largest_change(now[:, frames.index(f)], space.read(stage, _array(stage), f)) for f, stage in then.items()]
    return max(moved)


def _solve(
    space: Workspace, frames: tuple[int, ...], observed: Float32, confidence: Float32, previous: Float32 | None
) -> tuple[Float32, dict[str, Any]]:
    temporal, params = space.job.shot.temporal, of.energy_params(space.job.shot)
    matte = _mattes(space, frames)
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


def _observed(space: Workspace, frames: tuple[int, ...]) -> Float32:
    """Mean of the members [2, T, H, W]; 0.5 for a frame without a decomposition."""
    middle = np.full((2, space.job.height, space.job.width), 0.5, np.float32)
    absent = space.node.arguments["absent"]
    return np.stack([middle if f in absent else space.read("decompose", "observed", f) for f in frames], axis=1)


def _ensemble_confidence(space: Workspace, frames: tuple[int, ...]) -> Float32:
    """1 - sigma of the members [2, T, H, W]; 0 for a frame without a decomposition."""
    nothing = np.zeros((2, space.job.height, space.job.width), np.float32)
    absent = space.node.arguments["absent"]
    return np.stack(
        [nothing if f in absent else confidence(space.read("decompose", "spread", f)) for f in frames], axis=1
    )


def _mattes(space: Workspace, frames: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.stack([space.matte(frame) for frame in frames])


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


def _known(space: Workspace, frames: tuple[int, ...]) -> Float32 | None:
    """What earlier sweeps left of these frames, [2, T, H, W]; None in sweep 0."""
    stages: dict[int, str] = space.node.arguments["now"]
    if not stages:
        return None
    return np.stack([space.read(stages[f], _array(stages[f]), f) for f in frames], axis=1)


def _border_frames(space: Workspace) -> tuple[int, int]:
    """How many loaded frames before and after the block's outer span are its neighbours'."""
    outer = space.node.arguments["block"].outer
    start, stop = space.node.arguments["loaded"]
    return outer.start - start, stop - outer.stop


def _array(stage: str) -> str:
    return "material" if stage == "solve" else stage
