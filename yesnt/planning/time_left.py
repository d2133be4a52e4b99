"""How long a run has taken and how long it will, from the driver's events."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from yesnt.core.stage_id import StageId
from yesnt.planning.stages import STAGES


def stage_name(event: Mapping[str, Any]) -> str:
    """Row of the stage table that an event belongs to."""
    return StageId.parse(str(event["stage"])).name


class TimeLeft:
    """Seconds since the run began, and a prediction of those that are left.

    Work left is the tasks that are left in each stage, by the stage's mean so far, or by the stage table's model before
    its first task is done. It is divided by the workers that were busy on average since the first task started.

    Args:
        megapixels: of a frame.
        clock: monotonic seconds.
    """

    def __init__(self, megapixels: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._megapixels, self._clock = megapixels, clock
        self._begin = clock()
        self._first: float | None = None
        self._todo, self._count, self._spent = Counter[str](), Counter[str](), Counter[str]()

    def plan(self, todo: Mapping[str, int]) -> None:
        """Begins a pass: how many tasks of each stage are to do."""
        self._todo = Counter(todo)

    def apply(self, event: Mapping[str, Any]) -> None:
        """Takes one event of the driver."""
        if event["event"] == "plan":
            self.plan(Counter(event["stages"]) - Counter(event["reused"]))
        elif event["event"] == "start" and self._first is None:
            self._first = self._clock()
        elif event["event"] == "done":
            name = stage_name(event)
            self._todo[name] -= 1
            self._count[name] += 1
            self._spent[name] += event["seconds"]

    @property
    def elapsed(self) -> float:
        """Seconds since the run began."""
        return self._clock() - self._begin

    @property
    def left(self) -> float | None:
        """Seconds that are left; None before a task is done."""
        if self._first is None or not self._count:
            return None
        work = sum(count * self._each(name) for name, count in self._todo.items() if count > 0)
        busy = self._spent.total() / max(1e-6, self._clock() - self._first)
        return work / max(busy, 1e-3)

    def mean(self, name: str) -> float | None:
        """Mean seconds of a task of a stage so far; None before the first."""
        return self._spent[name] / self._count[name] if self._count[name] else None

    def _each(self, name: str) -> float:
        """Seconds that a task of a stage should take."""
        mean = self.mean(name)
        if mean is not None:
            return mean
        if name not in STAGES:  # of the evaluation or the capture stage
            return self._spent.total() / max(1, self._count.total())
        cost = STAGES[name].cost
        return cost.seconds + cost.seconds_per_megapixel * self._megapixels
