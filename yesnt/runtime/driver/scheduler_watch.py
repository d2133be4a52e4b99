"""Watches the scheduler: which workers there are, and whether it still answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from concurrent.futures import CancelledError, Future
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import ClusterLostError
from yesnt.runtime.driver.worker_pools import WorkerPools

if TYPE_CHECKING:
    from distributed import Client

HEARTBEAT_SECONDS = 2.0
LOSS_SECONDS = 8.0
"""A scheduler that has neither answered nor told of a task's end for this long is lost."""

GATHER_SECONDS = 0.02
"""Added to that for each result that is fetched."""

ALONE_SECONDS = 4.0
"""A scheduler without workers for this long is reported to the user."""

NO_WORKER = "the scheduler has no worker; the run goes on when one joins"


class SchedulerWatch:
    """Asks the scheduler every few seconds for its workers; notices when it no longer answers.

    Args:
        client: connected to the scheduler.
        pools: gets what the workers offer, if the job divides them.
    """

    def __init__(self, client: Client, pools: WorkerPools) -> None:
        self._pools = pools
        self._client, self._asked, self._last_sign = client, 0.0, time.monotonic()
        self._request: Future[Any] | None = None
        self._alone_since: float | None = None
        self._alone_told = False
        self.threads: dict[str, int] = {}
        """Worker threads by address, as the scheduler last said."""

    def refresh(self) -> None:
        """Asks, if it is time, and takes the answer to an earlier question; waits for the first answer only.

        Raises:
            ClusterLostError: the scheduler has given no sign of life for too long.
        """
        now = time.monotonic()
        if self._request is None and now - self._asked >= HEARTBEAT_SECONDS:
            self._asked, self._request = now, ask(self._client)
        if self._request is not None and (self._request.done() or not self.threads):
            self._take_answer(self._request)
            self._request = None
        if time.monotonic() - self._last_sign > LOSS_SECONDS:
            raise lost("it does not answer")

    def sign_of_life(self) -> None:
        """A task has ended: a scheduler that says so is not lost, however long its answers take."""
        self._last_sign = time.monotonic()

    def _take_answer(self, request: Future[Any]) -> None:
        try:
            threads = request.result(LOSS_SECONDS / 2)
        except (OSError, TimeoutError, RuntimeError, ValueError, AttributeError, CancelledError):
            request.cancel()
            return
        self.sign_of_life()
        if self._pools.divided and threads.keys() != self.threads.keys():
            self._pools.update(self._resources())
        self.threads = dict(threads)
        self._count(sum(self.threads.values()))

    def _resources(self) -> dict[str, Any]:
        """What each worker offers."""
        found = self._client.sync(self._client.scheduler.identity, n_workers=-1)
        return {address: worker["resources"] for address, worker in found["workers"].items()}

    def slots(self, blocked: Collection[str] = ()) -> int:
        """Threads of all workers but those of blocked hosts; at least 1, so that a task waits for the first worker."""
        return max(1, sum(count for worker, count in self.threads.items() if host_of(worker) not in blocked))

    def newly_alone(self) -> bool:
        """Whether there has been no worker for a while; True once each time that happens."""
        alone = self._alone_since is not None and time.monotonic() - self._alone_since >= ALONE_SECONDS
        newly, self._alone_told = alone and not self._alone_told, alone
        return newly

    def newly_waits(self, stages: Collection[str]) -> str:
        """What the run waits for, if no worker can take tasks of these stages; told once each time, else ""."""
        return NO_WORKER if self.newly_alone() else self._pools.newly_absent(stages)

    def _count(self, threads: int) -> None:
        if threads:
            self._alone_since = None
        elif self._alone_since is None:
            self._alone_since = self._last_sign


def ask(client: Client) -> Future[Any]:
    """Asks the scheduler for its workers; a busy one answers late, and the driver has other things to do meanwhile."""
    import asyncio

    request: Future[Any] = asyncio.run_coroutine_threadsafe(client.scheduler.ncores(), client.loop.asyncio_loop)
    return request


def host_of(worker: str) -> str:
    """The host of a worker's address: `tls://10.0.0.5:40123` is on `10.0.0.5`."""
    return worker.partition("://")[2].rpartition(":")[0] or worker


def no_worker_errors() -> tuple[type[Exception], ...]:
    """What Dask raises for a task that no worker has taken for too long."""
    from distributed.scheduler import NoValidWorkerError, NoWorkerError

    return NoValidWorkerError, NoWorkerError


def received(fetch: Callable[..., Any]) -> Any:
    """Fetches the result or the exception of a task that has ended.

    Raises:
        ClusterLostError: the scheduler is gone.
    """
    from distributed.client import FutureCancelledError

    try:
        return fetch(timeout=LOSS_SECONDS)
    except FutureCancelledError as error:
        raise lost("its futures are cancelled") from error
    except TimeoutError as error:
        raise lost("it does not hand a result over") from error


def lost(why: str) -> ClusterLostError:
    """The error of a scheduler that is gone."""
    return ClusterLostError(
        f"The scheduler is lost ({why})", "the Dask scheduler", "a scheduler that answers",
        "run the same command again: it resumes from what is committed",
    )  # fmt: skip


def without_workers() -> ClusterLostError:
    """The error of a scheduler that has had no worker for too long."""
    return ClusterLostError(
        "No worker has joined the scheduler for too long", "the Dask scheduler", "at least one worker",
        "start workers, then run the same command again: it resumes from what is committed",
    )  # fmt: skip
