"""A Dask client that runs tasks in the test's own process, on workers that exist by name only."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from yesnt.core.errors import ShortageError
from yesnt.runtime.driver import attempt as attempt_module
from yesnt.runtime.driver import driver as driver_module
from yesnt.runtime.driver import scheduler_watch

WORKERS = ("tcp://10.0.0.1:1", "tcp://10.0.0.2:1", "tcp://10.0.0.3:1")


class FakeClient:
    """Runs each task when the driver waits; `before` may raise what the task should fail with on a worker."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        before: Callable[[Any, str], None] = lambda node, worker: None,
        workers: tuple[str, ...] = WORKERS,
    ) -> None:
        self._here, self._before, self._choice = "", before, random.Random(0)
        self.workers = {worker: 1 for worker in workers}
        self.ran: list[tuple[str, int, str]] = []
        monkeypatch.setattr(attempt_module, "_own_address", lambda: self._here)
        without_event_loop(monkeypatch)

    def sync(self, call: Callable[[], Any], callback_timeout: float) -> dict[Any, Any]:
        return asyncio.run(call())

    async def gather(self, futures: dict[int, Any], errors: str, asynchronous: bool) -> dict[int, Any]:
        return {i: future.result(1) for i, future in futures.items()}

    def submit(self, attempt, task, context, node, *, workers=None, **options: Any) -> _Future:
        self._here = self._choice.choice(sorted(workers or self.workers))
        self.ran.append((node.stage.label, node.index, self._here))
        before, here = self._before, self._here

        def watched(context: Any, node: Any) -> dict[str, Any]:
            before(node, here)
            return task(context, node)

        try:
            return _Future(attempt(watched, context, node), None)
        except Exception as error:
            return _Future(None, error)


def without_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver takes the ends of tasks from `status` of futures, and the workers from `workers` of its client."""

    def ask(client: Any) -> Future[dict[str, int]]:
        answer: Future[dict[str, int]] = Future()
        answer.set_result(client.workers)
        return answer

    monkeypatch.setattr(driver_module, "Completions", FakeCompletions)
    monkeypatch.setattr(scheduler_watch, "ask", ask)


class FakeCompletions:
    """Futures of fake clients; one has ended unless its status is "pending"."""

    def __init__(self, client: Any) -> None:
        self._waiting: list[tuple[Any, Any]] = []

    def add(self, node_id: Any, future: Any) -> None:
        self._waiting.append((node_id, future))

    def take(self, seconds: float) -> list[tuple[Any, Any]]:
        ended = [row for row in self._waiting if row[1].status != "pending"]
        self._waiting = [row for row in self._waiting if row[1].status == "pending"]
        if not ended:
            time.sleep(min(seconds, 0.01))
        return ended


class _Future:
    def __init__(self, result: Any, error: Exception | None) -> None:
        self._result, self._error = result, error
        self.status = "finished" if error is None else "error"

    def result(self, timeout: float) -> Any:
        return self._result

    def exception(self, timeout: float) -> Exception | None:
        return self._error

    def release(self) -> None:
        pass


def short_of(resource: str, times: int) -> Callable[[Any, str], None]:
    """Lets tasks meet a shortage so many times."""
    left = [times]

    def before(node: Any, worker: str) -> None:
        if left[0]:
            left[0] -= 1
            raise ShortageError(f"No {resource} is free")

    return before
