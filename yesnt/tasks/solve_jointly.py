"""Task of a joint sweep: solves the pixels that the exchanges of a round left unconverged, in all frames together.

See temporal/joint.py. Frames are read one at a time, in a few passes: how far pixels moved, which are unconverged, and
their lists. Masks of the sequence, a bit for each pixel, and the lists stay in memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.planning.chunks import ROUND
from yesnt.planning.task_records import SolveJointlyTask
from yesnt.tasks.decoded import release_memory
from yesnt.tasks.memory import trim_memory
from yesnt.tasks.solve_window import Links, Window, keep, known, listed, solve_window
from yesnt.tasks.workspace import Workspace
from yesnt.temporal.geometry import PackedMasks
from yesnt.temporal.joint import ChangeCounter, FrameLinks, listed_frames, unconverged_pixels

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Space = Workspace[SolveJointlyTask]

UNCONVERGED = 0.3
"""A pixel is unconverged if the round moved it by more than this share of the tolerance."""

ATTEMPTS = 4
"""How often the threshold is raised until the unconverged pixels and their surroundings fit into memory."""


def solve_jointly(space: Space) -> None:
    """Commits the material [2, H, W] of all frames: solved where unconverged, unchanged elsewhere."""
    release_memory()
    window, facts = _choose(space)
    if window is None:
        for frame in space.pending():
            keep(space, frame, facts, None)
    else:
        start = listed(window, lambda frame: _known(space, frame))
        value, solved = solve_window(space, window, start)
        _commit(space, window, value, facts | solved)
    trim_memory()  # the next task's peak would add to the freed lists


def _commit(space: Space, window: Window, value: Float32, facts: dict[str, Any]) -> None:
    """Writes the frames that have free pixels with their new value [2, N], and keeps the others."""
    first = np.cumsum([0, *(np.count_nonzero(window.matte[t]) for t in range(len(window.frames)))])
    pending = set(space.pending())
    for index, frame in enumerate(space.job.frames):
        if frame not in pending:
            continue
        if window.fixed[index][window.matte[index]].all():
            keep(space, frame, facts, None)
            continue
        whole = _known(space, frame).copy()
        whole[:, window.matte[index]] = value[:, first[index] : first[index + 1]]
        space.commit(frame, {"material": whole}, facts=facts)


def _choose(space: Space) -> tuple[Window | None, dict[str, Any]]:
    """The unconverged pixels and their surroundings, as many as memory allows; None if all have converged."""
    room = space.task.exchange.chunks.joint
    count, largest = _count(space)
    facts: dict[str, Any] = {"moved": min(largest, 1.0), "unconverged": 0}
    smallest = UNCONVERGED * space.job.shot.temporal.tolerance
    if not space.job.shot.temporal.enabled or largest <= smallest:
        return None, facts
    allowed, choice = room, _Choice(space)
    for _ in range(ATTEMPTS):
        threshold = count.threshold(smallest, allowed)
        window = choice.window(threshold)
        pixels = _size(window.matte)
        if pixels <= room:
            free = pixels - _size(window.fixed)
            return (window if free else None), facts | {"unconverged": free, "threshold": min(threshold, 1.0)}
        allowed = allowed * room // (2 * pixels)
    return None, facts


def _size(masks: Mask | PackedMasks) -> int:
    return int(sum(np.count_nonzero(masks[t]) for t in range(len(masks))))


def _known(space: Space, frame: int, sweeps_ago: int = 0) -> Float32:
    """A frame [2, H, W] as it was before this sweep, or so many sweeps earlier."""
    return known(space, frame, range(len(space.task.bands)), space.task.sweep - sweeps_ago)


def _moved(space: Space, frame: int) -> Float32:
    """How far the round moved a frame, [H, W], the larger of the two channels; 0 outside the matte."""
    now, then = _known(space, frame), _known(space, frame, ROUND - 1)
    change: Float32 = np.abs(now - then).max(axis=0)
    return np.where(space.matte(frame), change, np.float32(0))


def _count(space: Space) -> tuple[ChangeCounter, float]:
    """How many pixels moved how far, and the largest change."""
    count, largest = ChangeCounter(), 0.0
    for frame in space.job.frames:
        change = _moved(space, frame)[space.matte(frame)]
        count.add(change)
        largest = max(largest, float(change.max(initial=0.0)))
    return count, largest


@dataclass(frozen=True)
class _Choice:
    """Masks of the whole sequence for a threshold."""

    space: Space

    def window(self, threshold: float) -> Window:
        """Free pixels are those that moved by more than the threshold and their surroundings."""
        space, frames = self.space, self.space.job.frames
        shape = (len(frames), space.job.height, space.job.width)
        free, rim = PackedMasks(shape), PackedMasks(shape)
        for index, frame in enumerate(frames):
            free[index] = unconverged_pixels(_moved(space, frame) > threshold, space.matte(frame))
        links = Links(space, Window(frames, slice(0, space.job.height), free, free))

        def read(index: int) -> FrameLinks:
            pair = links.pair(index) if index + 1 < len(frames) else (None, None)
            return FrameLinks(space.matte(frames[index]), *pair)

        # Once a frame has been listed, its fixed pixels take the memory of its free ones: there is room for two masks.
        for index, found in enumerate(listed_frames(read, lambda t: free[t], len(frames))):
            rim[index] = found
            free[index] = found & ~free[index]
        return Window(frames, slice(0, space.job.height), rim, free)
