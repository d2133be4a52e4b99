"""Stages that wait for something that comes back: a licence, a busy GPU, room on the disk."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

FIRST_PAUSE, LONGEST_PAUSE = 5.0, 60.0
"""Seconds until one task of a stage is tried again: doubled after each attempt that meets the same shortage."""

REMIND_SECONDS = 600.0
"""A shortage that lasts is reported again after this long."""


@dataclass
class _Wait:
    reason: str
    pause: float
    again: float  # monotonic time of the next attempt
    told: float
    trying: bool = False


class Shortages:
    """Decides which stages may start tasks. A stage that met a shortage tries one task from time to time.

    Args:
        tell: called with an event when a stage pauses, still waits, or goes on.
        first_pause: seconds until the first attempt.
    """

    def __init__(self, tell: Callable[[Mapping[str, Any]], None], first_pause: float = FIRST_PAUSE) -> None:
        self._tell, self._first_pause = tell, first_pause
        self._waits: dict[str, _Wait] = {}

    def met(self, stage: str, reason: str) -> None:
        """A task of a stage could not run for want of something."""
        now, wait = time.monotonic(), self._waits.get(stage)
        if wait is None:
            self._waits[stage] = _Wait(reason, self._first_pause, now + self._first_pause, now)
            self._say("shortage", stage, reason)
            return
        if wait.trying:
            wait.pause = min(2 * wait.pause, LONGEST_PAUSE)
        wait.reason, wait.trying, wait.again = reason, False, now + wait.pause
        if now - wait.told > REMIND_SECONDS:
            wait.told = now
            self._say("shortage", stage, reason)

    def admit(self, stage: str) -> bool:
        """Whether one task of a stage may start now; asked once for each task."""
        wait = self._waits.get(stage)
        if wait is None:
            return True
        if wait.trying or time.monotonic() < wait.again:
            return False
        wait.trying = True
        return True

    def ended(self, stage: str) -> None:
        """A task of a stage ended in another way than by the shortage.

        If it was the one that tried, there is enough again; if it had begun before, it may have given back what lacks.
        """
        wait = self._waits.get(stage)
        if wait is None:
            return
        if wait.trying:
            del self._waits[stage]
            self._say("shortage_over", stage, "")
        else:
            wait.again = time.monotonic()

    def _say(self, event: str, stage: str, reason: str) -> None:
        self._tell({"event": event, "time": time.time(), "stage": stage, "reason": reason})
