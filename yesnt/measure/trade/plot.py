"""The curve of seconds against error as SVG: one panel per stage, the frontier joined by a line."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from yesnt.io.templates import render
from yesnt.measure.trade.choose import Point, frontier
from yesnt.measure.trade.variants import STAGES

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 470, 300, 62, 42, 26
"""Of a panel, in SVG units: its size, and the margins of the plot inside it."""

RIGHT = 20
"""Margin at the right."""

LEAST_ERROR = 1e-5
"""Smaller errors are drawn here: the reference's own is 0, and the axis is logarithmic."""


def plot_svg(points: Sequence[Point]) -> str:
    """An SVG document; both axes are logarithmic, and a stage without points has no panel."""
    of_stage = [[point for point in points if point.stage == stage] for stage in STAGES]
    panels = [
        _panel(some[0].stage, some) | {"x": (place % 2) * WIDTH, "y": (place // 2) * HEIGHT}
        for place, some in enumerate(filter(None, of_stage))
    ]
    edges = {"left": LEFT, "right": WIDTH - RIGHT, "top": TOP, "bottom": HEIGHT - BOTTOM}
    height = -(-len(panels) // 2) * HEIGHT
    return render("trade.svg.jinja", panels=panels, width=2 * WIDTH, height=height, **edges)


def _panel(stage: str, points: Sequence[Point]) -> dict[str, Any]:
    seconds, errors = [p.seconds for p in points], [max(p.error, LEAST_ERROR) for p in points]
    x, y = _axis(seconds, LEFT, WIDTH - RIGHT), _axis(errors, HEIGHT - BOTTOM, TOP)
    best = frontier(points)
    return {
        "stage": stage,
        "seconds": [{"place": f"{x(value):.1f}", "text": f"{value:.2g}"} for value in _ticks(seconds)],
        "errors": [{"place": f"{y(value) + 4:.1f}", "text": f"{value:.0e}"} for value in _ticks(errors)],
        "frontier": " ".join(f"{x(p.seconds):.1f},{y(max(p.error, LEAST_ERROR)):.1f}" for p in best),
        "dots": [_dot(p, x(p.seconds), y(max(p.error, LEAST_ERROR)), p in best) for p in points],
    }


def _dot(point: Point, x: float, y: float, best: bool) -> dict[str, Any]:
    title = f"{point.name}: {point.seconds:.3g} s, error {point.error:.3g}"
    place = {"x": f"{x:.1f}", "y": f"{y:.1f}", "label_x": f"{x + 6:.1f}", "label_y": f"{y - 5:.1f}"}
    return {"name": point.name, "title": title, "best": best, **place}


def _axis(values: Sequence[float], start: float, stop: float) -> Callable[[float], float]:
    """Maps values to places from start to stop, logarithmically, with room at both ends."""
    low, high = (math.log(max(v, 1e-9)) for v in (min(values), max(values)))
    low, high = low - 0.05 * (high - low) - 1e-3, high + 0.25 * (high - low) + 1e-3

    def place(value: float) -> float:
        return start + (stop - start) * (math.log(max(value, 1e-9)) - low) / (high - low)

    return place


def _ticks(values: Sequence[float]) -> list[float]:
    """Four values, evenly spread in the logarithm; one if all are equal."""
    low, high = (math.log(max(v, 1e-9)) for v in (min(values), max(values)))
    return [math.exp(low + (high - low) * i / 3) for i in range(4)] if high > low else [math.exp(low)]
