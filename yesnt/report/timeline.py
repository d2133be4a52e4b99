"""The timeline of a run as inline SVG: a lane a worker, a bar a task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from yesnt.planning.stages import STAGES

WIDTH, LANE = 1000, 22


def timeline_svg(tasks: Sequence[dict[str, Any]]) -> str:
    """SVG text, or "" without tasks."""
    if not tasks:
        return ""
    begin, end = min(t["begin"] for t in tasks), max(t["end"] for t in tasks)
    scale = WIDTH / max(end - begin, 1e-6)
    workers = {worker: lane for lane, worker in enumerate(sorted({t["worker"] for t in tasks}))}
    bars = [_bar(task, begin, scale, workers[task["worker"]]) for task in tasks]
    height = LANE * len(workers) + 40
    legend = "".join(
        f'<rect x="{i * 110}" y="{height - 16}" width="12" height="12" fill="{row.color}"/>'
        f'<text x="{i * 110 + 16}" y="{height - 6}" font-size="12">{row.name}</text>'
        for i, row in enumerate(STAGES.values())
    )
    axis = f'<text x="{WIDTH}" y="{height - 6}" font-size="12" text-anchor="end">{end - begin:.0f} s</text>'
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" width="100%" xmlns="http://www.w3.org/2000/svg">'
        f"{''.join(bars)}{legend}{axis}</svg>"
    )


def _bar(task: dict[str, Any], begin: float, scale: float, lane: int) -> str:
    x, width = (task["begin"] - begin) * scale, max(0.5, (task["end"] - task["begin"]) * scale)
    title = f"{task['stage']} {task['frame']}: {task['end'] - task['begin']:.2f} s"
    color = STAGES[task["stage"]].color
    return (
        f'<rect x="{x:.1f}" y="{lane * LANE}" width="{width:.1f}" height="{LANE - 3}" fill="{color}">'
        f"<title>{title}</title></rect>"
    )
