"""Chooses settings from the measured points: the frontier of each stage, and the cheapest combination."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from yesnt.measure.trade.variants import STAGES


@dataclass(frozen=True)
class Point:
    """Cost and error of one setting of one stage.

    Attributes:
        stage: name of the stage.
        name: label of the setting.
        seconds: processor seconds per frame.
        error: root mean square display difference of the relit frame from the one under the stage's reference.
        evaluations: network evaluations (NFE) per frame.
        truth: the same difference from what true materials give, for a stage that decides on materials; None if the
            shot has no truth.
    """

    stage: str
    name: str
    seconds: float
    error: float
    evaluations: float = 0.0
    truth: float | None = None


@dataclass(frozen=True)
class Choice:
    """One setting per stage; errors of stages are assumed to be independent, so their squares add."""

    names: dict[str, str]
    seconds: float
    error: float


def frontier(points: Sequence[Point]) -> list[Point]:
    """The Pareto frontier: points that no other beats in both seconds and error, cheapest first."""
    best, found = math.inf, []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if point.error < best:
            best = point.error
            found.append(point)
    return found


def combinations(points: Sequence[Point]) -> list[Choice]:
    """Every combination of one point of each stage's frontier, cheapest first."""
    fronts = [frontier([p for p in points if p.stage == stage]) for stage in STAGES]
    ways = (
        Choice(
            {p.stage: p.name for p in way}, sum(p.seconds for p in way), math.sqrt(sum(p.error**2 for p in way))
        )
        for way in product(*(front for front in fronts if front))
    )  # fmt: skip
    return sorted(ways, key=lambda choice: (choice.seconds, choice.error))


def cheapest(points: Sequence[Point], error: float | None, seconds: float | None) -> Choice | None:
    """The cheapest settings within an error or, given seconds, the most accurate within them; None if there is none."""
    ways = combinations(points)
    if seconds is not None:
        within = [way for way in ways if way.seconds <= seconds and (error is None or way.error <= error)]
        return min(within, key=lambda way: way.error, default=None)
    return next((way for way in ways if error is None or way.error <= error), None)
