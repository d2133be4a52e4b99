"""Task that solves one block of the temporal energy: a chunk of frames, whole or in one band of rows.

Frames are read one at a time and cut to the matte pixels of the block, so that a task's memory follows its block. The
method is in temporal/blocks.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.blocks import Block
from yesnt.planning.stages import FLOW
from yesnt.planning.task_records import SolveBlockTask
from yesnt.tasks.decoded import release_memory
from yesnt.tasks.memory import trim_memory
from yesnt.tasks.observations import observed
from yesnt.tasks.solve_window import Window, keep, known, listed, solve_window
from yesnt.tasks.workspace import Workspace

Float32 = NDArray[np.float32]
Space = Workspace[SolveBlockTask]

SETTLED = 0.1
"""A block keeps its value if its border moved by less than this share of the tolerance since its last solve."""


def solve_block(space: Space) -> None:
    """Commits the material [2, h, W] of one block after one sweep, h being the rows of its band."""
    release_memory()
    window = _window(space)
    value, facts = _value(space, window)
    pending = set(space.pending())
    for frame in space.node.frames:
        if frame not in pending:
            continue
        if value is None:
            keep(space, frame, facts, space.task.band)
        else:
            space.commit(frame, {"material": _dense(space, window, value, frame)}, facts=facts)
    trim_memory()  # the next task's peak would add to the freed lists


def _window(space: Space) -> Window:
    """The frames and rows that the block loads; what belongs to its neighbours is fixed."""
    block, band = space.task.exchange.blocks[space.task.chunk], _band(space)
    loaded = space.task.exchange.loaded(block, space.task.sweep)
    frames = space.job.frames[loaded.start : loaded.stop]
    reach = _reach(space, frames) if space.task.sweep else 0
    rows = slice(max(0, band.outer.start - reach), min(space.job.height, band.outer.stop + reach))
    matte = np.stack([space.matte(frame)[rows] for frame in frames])
    fixed = np.ones(matte.shape, bool)
    inner = slice(block.outer.start - loaded.start, block.outer.stop - loaded.start)
    fixed[inner, band.outer.start - rows.start : band.outer.stop - rows.start] = False
    return Window(frames, rows, matte, fixed)


def _band(space: Space) -> Block:
    return space.task.bands[space.task.band]


def _reach(space: Space, frames: tuple[int, ...]) -> int:
    """Rows around a band that its links reach: the largest of the flow's records, at most what the plan allows."""
    records = [space.book.find(FLOW, frame) for frame in frames[:-1]]
    limit = space.task.exchange.chunks.reach
    return min(limit, max((limit if r is None else int(r.facts.get("reach", limit)) for r in records), default=0))


def _touched(space: Space) -> tuple[int, ...]:
    """Bands whose rows the block may load."""
    return space.task.exchange.chunks.touched(_band(space), space.task.sweep)


def _value(space: Space, window: Window) -> tuple[Float32 | None, dict[str, Any]]:
    """The solved material [2, N] of the window's matte pixels, or None for a block at rest, and facts."""
    task, temporal = space.task, space.job.shot.temporal
    if not temporal.enabled:
        return listed(window, lambda frame: observed(space, task.gaps, frame)), {}
    if task.sweep == 0:
        return solve_window(space, window, None)
    bands = _touched(space)
    now = listed(window, lambda frame: known(space, frame, bands, task.sweep))
    seam = _seam(space, window, now)
    if seam < SETTLED * temporal.tolerance:
        return None, {"seam": seam, "skipped": True}
    value, facts = solve_window(space, window, now)
    return value, facts | {"seam": min(seam, 1.0)}


def _seam(space: Space, window: Window, now: Float32) -> float:
    """Largest change of the border since this block's last solve; infinite if it has had no border yet."""
    last = space.task.exchange.last_solve(space.task.chunk, space.task.band, space.task.sweep)
    if last == 0:
        return np.inf
    moved, first, bands = 0.0, 0, _touched(space)
    for index, frame in enumerate(window.frames):
        matte, fixed = window.matte[index], window.fixed[index]
        count = int(matte.sum())
        border = fixed[matte]
        if border.any():
            before = window.pixels(index, known(space, frame, bands, last))
            moved = max(moved, float(np.abs(now[:, first : first + count] - before)[:, border].max()))
        first += count
    return moved


def _dense(space: Space, window: Window, value: Float32, frame: int) -> Float32:
    """One frame's core rows [2, h, W]: the value inside the matte, what was observed outside."""
    index, core = window.frames.index(frame), _band(space).core
    first = sum(int(window.matte[t].sum()) for t in range(index))
    dense = observed(space, space.task.gaps, frame)[:, window.rows].copy()
    matte = window.matte[index]
    dense[:, matte] = value[:, first : first + int(matte.sum())]
    return dense[:, core.start - window.rows.start : core.stop - window.rows.start]
