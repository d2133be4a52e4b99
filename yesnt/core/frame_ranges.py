"""Frame numbers as text: `1001-1010,1020-1040x2`, the form that `frames:` takes."""

from __future__ import annotations

from collections.abc import Iterable

_SHORTEST_STEP_RUN = 3
"""Frames of a run with a step at least; fewer are listed one by one."""


def frame_ranges(frames: Iterable[int]) -> str:
    """Frame numbers in any order as the shortest list of runs with one step each; "" for none."""
    rest, parts = sorted(set(frames)), []
    first = 0
    while first < len(rest):
        stop = _run(rest, first)
        parts.append(_text(rest[first:stop]))
        first = stop
    return ",".join(parts)


def _run(frames: list[int], first: int) -> int:
    """Index behind the longest run with one step that begins at `first`; a run of two only if they are neighbours."""
    if first + 1 == len(frames):
        return first + 1
    step, stop = frames[first + 1] - frames[first], first + 2
    while stop < len(frames) and frames[stop] - frames[stop - 1] == step:
        stop += 1
    return stop if step == 1 or stop - first >= _SHORTEST_STEP_RUN else first + 1


def _text(run: list[int]) -> str:
    if len(run) == 1:
        return str(run[0])
    step = run[1] - run[0]
    return f"{run[0]}-{run[-1]}" + ("" if step == 1 else f"x{step}")
