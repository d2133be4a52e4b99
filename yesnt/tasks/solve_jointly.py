"""The joint sweep of the temporal solve: what exchanges between blocks still move, in all frames at once.

See temporal/joint.py. Frames are read one at a time, in a few passes: how far pixels moved, which are unconverged, and
their lists. What stays in memory is masks of the sequence, a bit a pixel, and the lists.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.tasks.solve import Links, Window, array_of, keep, known, listed, solve_window
from yesnt.tasks.workspace import Workspace
from yesnt.temporal.geometry import PackedMasks
from yesnt.temporal.joint import ChangeCounter, FrameLinks, listed_frames, unconverged_pixels

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

UNCONVERGED = 0.3
"""A pixel is unconverged if the round moved it by more than this share of the tolerance."""

ATTEMPTS = 4
"""How often the choice is narrowed until the unconverged pixels and their rim fit into memory."""


def solve_jointly(space: Workspace) -> None:
    """Commits all frames: solved where they were unconverged, unchanged elsewhere."""
    now: dict[int, dict[int, str]] = space.node.arguments["now"]
    window, facts = _choose(space)
    if window is None:
        for frame in space.pending():
            keep(space, frame, facts, None)
        return
    start = listed(window, lambda frame: known(space, now[frame], frame))
    value, solved = solve_window(space, window, start)
    first = np.cumsum([0, *(np.count_nonzero(window.matte[t]) for t in range(len(window.frames)))])

    pending = set(space.pending())
    for index, frame in enumerate(space.job.frames):
        if frame not in pending:
            continue
        if window.fixed[index][window.matte[index]].all():
            keep(space, frame, facts | solved, None)
            continue
        whole = known(space, now[frame], frame).copy()
        whole[:, window.matte[index]] = value[:, first[index] : first[index + 1]]
        space.commit(frame, {array_of(space.node.stage): whole}, facts=facts | solved)


def _choose(space: Workspace) -> tuple[Window | None, dict[str, Any]]:
    """The window of the unconverged pixels and their rim, as many as memory allows; None if there are none."""
    room: int = space.node.arguments["joint"]
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


def _moved(space: Workspace, frame: int) -> Float32:
    """How far the round moved a frame, [H, W], the worse of the channels; 0 outside the matte."""
    now, then = (known(space, space.node.arguments[state][frame], frame) for state in ("now", "then"))
    change: Float32 = np.abs(now - then).max(axis=0)
    return np.where(space.matte(frame), change, np.float32(0))


def _count(space: Workspace) -> tuple[ChangeCounter, float]:
    count, largest = ChangeCounter(), 0.0
    for frame in space.job.frames:
        change = _moved(space, frame)[space.matte(frame)]
        count.add(change)
        largest = max(largest, float(change.max(initial=0.0)))
    return count, largest


@dataclass(frozen=True)
class _Choice:
    """Masks of the whole sequence for a threshold."""

    space: Workspace

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

        # What is fixed takes the place of what is free as soon as a frame has been listed: there is room for two masks.
        for index, found in enumerate(listed_frames(read, lambda t: free[t], len(frames))):
            rim[index] = found
            free[index] = found & ~free[index]
        return Window(frames, slice(0, space.job.height), rim, free)
