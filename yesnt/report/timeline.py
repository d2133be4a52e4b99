"""The timeline of a run as inline SVG: one lane per worker, one bar per task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from yesnt.io.templates import render
from yesnt.planning.stages import STAGES

WIDTH, LANE = 1000, 22
"""Width of the drawing and height of a lane, in SVG units."""

_LEGEND = 40  # SVG units below the lanes
_NARROWEST = 0.5  # SVG units: shorter tasks stay visible


def timeline_svg(tasks: Sequence[dict[str, Any]]) -> str:
    """SVG text, or "" without tasks.

    Args:
        tasks: one dictionary per task: `stage`, `frame`, `worker` (process id), `begin` and `end` (seconds).
    """
    if not tasks:
        return ""
    begin, end = min(task["begin"] for task in tasks), max(task["end"] for task in tasks)
    scale = WIDTH / max(end - begin, 1e-6)
    lanes = {worker: lane for lane, worker in enumerate(sorted({task["worker"] for task in tasks}))}
    return render(
        "timeline.svg.jinja",
        bars=[_bar(task, begin, scale, lanes[task["worker"]]) for task in tasks],
        stages=list(STAGES.values()),
        width=WIDTH,
        height=LANE * len(lanes) + _LEGEND,
        seconds=end - begin,
    )


def _bar(task: dict[str, Any], begin: float, scale: float, lane: int) -> dict[str, Any]:
    seconds = task["end"] - task["begin"]
    return {
        "x": f"{(task['begin'] - begin) * scale:.1f}",
        "y": lane * LANE,
        "width": f"{max(_NARROWEST, seconds * scale):.1f}",
        "height": LANE - 3,
        "color": STAGES[task["stage"]].color,
        "title": f"{task['stage']} {task['frame']}: {seconds:.2f} s",
    }
