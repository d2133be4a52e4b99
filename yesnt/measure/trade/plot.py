"""The curve of seconds against error as SVG: one panel a stage, the frontier joined."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from html import escape

from yesnt.measure.trade.choose import Point, frontier
from yesnt.measure.trade.variants import STAGES

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 470, 300, 62, 42, 26
LEAST_ERROR = 1e-5
"""Errors below are drawn here: the reference's own is 0, and the axis is logarithmic."""


def plot_svg(points: Sequence[Point]) -> str:
    """An SVG document; both axes are logarithmic."""
    panels = [_panel(stage, [p for p in points if p.stage == stage]) for stage in STAGES]
    placed = [
        f'<g transform="translate({(i % 2) * WIDTH},{(i // 2) * HEIGHT})">{panel}</g>' for i, panel in enumerate(panels)
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * WIDTH} {2 * HEIGHT}" width="100%" '
        f'font-family="sans-serif" font-size="11"><rect width="100%" height="100%" fill="#fff"/>{"".join(placed)}</svg>'
    )


def _panel(stage: str, points: Sequence[Point]) -> str:
    if not points:
        return ""
    x = _axis([p.seconds for p in points], LEFT, WIDTH - 20)
    y = _axis([max(p.error, LEAST_ERROR) for p in points], HEIGHT - BOTTOM, TOP)
    front = frontier(points)
    path = " ".join(f"{x(p.seconds):.1f},{y(max(p.error, LEAST_ERROR)):.1f}" for p in front)
    dots = "".join(_dot(p, x(p.seconds), y(max(p.error, LEAST_ERROR)), p in front) for p in points)
    ticks = "".join(
        f'<text x="{x(v):.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{v:.2g}</text>'
        for v in _ticks([p.seconds for p in points])
    ) + "".join(
        f'<text x="{LEFT - 6}" y="{y(v) + 4:.1f}" text-anchor="end">{v:.0e}</text>'
        for v in _ticks([max(p.error, LEAST_ERROR) for p in points])
    )
    return (
        f'<text x="{LEFT}" y="16" font-size="13" font-weight="bold">{stage}</text>'
        f'<path d="M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - 20}" fill="none" stroke="#999"/>{ticks}'
        f'<text x="{WIDTH - 20}" y="{HEIGHT - 8}" text-anchor="end">processor seconds a frame</text>'
        f'<text x="{LEFT + 4}" y="{TOP + 4}" fill="#666">display error</text>'
        f'<polyline points="{path}" fill="none" stroke="#4878a8" stroke-width="1.5"/>{dots}'
    )


def _dot(point: Point, x: float, y: float, best: bool) -> str:
    color = "#4878a8" if best else "#bbb"
    label = f'<text x="{x + 6:.1f}" y="{y - 5:.1f}" fill="#333">{escape(point.name)}</text>' if best else ""
    title = f"{point.name}: {point.seconds:.3g} s, error {point.error:.3g}"
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{color}"><title>{escape(title)}</title></circle>{label}'


def _axis(values: Sequence[float], start: float, stop: float) -> Callable[[float], float]:
    low, high = (math.log(max(v, 1e-9)) for v in (min(values), max(values)))
    low, high = low - 0.05 * (high - low) - 1e-3, high + 0.25 * (high - low) + 1e-3

    def place(value: float) -> float:
        return start + (stop - start) * (math.log(max(value, 1e-9)) - low) / (high - low)

    return place


def _ticks(values: Sequence[float]) -> list[float]:
    """About four values, evenly spread in the logarithm."""
    low, high = (math.log(max(v, 1e-9)) for v in (min(values), max(values)))
    return [math.exp(low + (high - low) * i / 3) for i in range(4)] if high > low else [math.exp(low)]
