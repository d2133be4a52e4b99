"""Starts a local Dask cluster, or connects to one that is running; plain TCP on this machine only, else TLS."""

from __future__ import annotations

import importlib
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import ClusterLostError, MissingPartError, UsageError
from yesnt.core.threads import THREAD_VARIABLES, pin_threads
from yesnt.runtime.precompile import compile_missing
from yesnt.runtime.stop_cluster import children_without_interrupt, start_quiet_tracker, stop_now

if TYPE_CHECKING:
    from distributed import Client

ALLOCATOR = {
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(512 << 20), "MALLOC_ARENA_MAX": "1",
}  # fmt: skip
"""A worker keeps freed pages for its next frame. Dask's own setting (trim at 64 kB) returns every large array to the
kernel and faults it in again: 43 % of the processor time of decomposition, for 4 % less memory."""

WORKER_ENVIRONMENT = {**dict.fromkeys(THREAD_VARIABLES, "1"), **ALLOCATOR, "PYTHONHASHSEED": "6640"}
"""Environment of local workers and of the process that they are forked from; the hash seed is Dask's default."""

_CONNECT_SECONDS = 20

_PREPARE_PAUSES = (0.5, 1.0, 2.0, 4.0, 4.0, 4.0)
"""Seconds after a failed attempt to prepare the workers; in that time a worker that restarts is back."""

_NOISY = (
    "asyncio", "tornado.application", "distributed", "distributed.client", "distributed.core", "distributed.comm",
    "distributed.nanny", "distributed.scheduler", "distributed.worker", "distributed.utils", "distributed.batched",
)  # fmt: skip
"""Loggers that tell of lost connections, with tracebacks."""


@dataclass(frozen=True)
class ClusterSpec:
    """Where tasks run.

    Attributes:
        kind: "local", or the address of a running scheduler (`tcp://127.0.0.1:8786`, `tls://host:8786`).
        workers: processes of a local cluster.
        memory: limit of a local worker in bytes; 0 leaves it to Dask (all memory / workers).
    """

    kind: str = "local"
    workers: int = 2
    memory: int = 0


def check_kind(spec: ClusterSpec) -> None:
    """Refuses a kind of cluster that is not known, before anything is written.

    Raises:
        UsageError: the kind is unknown, or a scheduler off this machine is asked for without TLS.
    """
    kind, here = spec.kind, ("tcp://127.", "tcp://localhost", "tcp://[::1]")
    if kind == "local" or kind.startswith(("tls://", *here)):
        return
    if kind.startswith("tcp://"):
        raise UsageError(
            "A scheduler on another machine must use TLS: whoever reaches it runs code",
            f"--cluster {kind}", "tls://HOST:PORT", "start the scheduler with TLS, or tunnel it to 127.0.0.1",
        )  # fmt: skip
    raise UsageError(
        f"No cluster of the kind {kind!r}", "--cluster", "local, tcp://127.0.0.1:PORT or tls://HOST:PORT",
        "start a scheduler and workers by SSH or by your farm's own means (deploy/README.md), and give its address",
    )  # fmt: skip


def warm_up(spec: ClusterSpec, modules: tuple[str, ...]) -> None:
    """Starts the server process that local workers are forked from; it imports modules for all of them.

    Imports take more processor time than all else in a worker's start, and a worker that replaces a dead one would
    pay them again. The process has one thread, since every library in it is pinned before it starts. It ends
    with its last child. Where a server runs already (a user's own), workers import for themselves.
    """
    if spec.kind != "local":
        return
    from multiprocessing import forkserver

    start_quiet_tracker()
    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    os.environ.update(WORKER_ENVIRONMENT)
    try:
        forkserver.set_forkserver_preload(["distributed", "distributed.nanny", *modules])
        with children_without_interrupt():
            forkserver.ensure_running()
    finally:
        _restore(before)


@contextmanager
def open_cluster(spec: ClusterSpec, modules: tuple[str, ...] = ()) -> Iterator[Client]:
    """Yields a client whose workers have one thread each, with every library pinned to it.

    Args:
        spec: where tasks run.
        modules: what each worker imports before its first task.

    Raises:
        UsageError: the kind is unknown, or a scheduler off this machine is asked for without TLS.
        ClusterLostError: the scheduler does not answer.
        MissingPartError: the kind needs an extra that is absent.
    """
    import dask
    import distributed  # noqa: F401 - it sets up its loggers, which are silenced below

    with dask.config.set(dask_settings()), _quiet(), _address(spec) as address:
        client = _connect(address)
        try:
            _prepare_workers(client, _prepare_plugin(modules, compiles=spec.kind != "local"))
            yield client
        except KeyboardInterrupt:
            stop_now(client)
            raise
        finally:
            _close(client)


def _connect(address: Any) -> Client:
    from distributed import Client

    try:
        return Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise ClusterLostError(
            "The scheduler does not answer", str(address), "a running Dask scheduler", "start it, then run again"
        ) from error


def dashboard_of(client: Client) -> str:
    """Address of the scheduler's dashboard; "" if it has none."""
    try:
        return str(client.dashboard_link or "")
    except (AttributeError, KeyError, OSError, TimeoutError, ValueError):  # no dashboard, or the scheduler is gone
        return ""


def address_of(client: Client) -> str:
    """Address of the scheduler; "" if the connection is lost (the driver notices)."""
    return str(getattr(client.scheduler, "address", ""))


def _prepare_workers(client: Client, plugin: Any) -> None:
    """Registers a plugin with all workers, present and future.

    The scheduler hands it to one worker after another and fails if one leaves meanwhile (its lifetime ends, a farm
    takes it back); then all that are left are asked again.

    Raises:
        ClusterLostError: that happened again and again, or the scheduler is gone.
    """
    problem: Exception | None = None
    for pause in _PREPARE_PAUSES:
        try:
            client.register_plugin(plugin)
            return
        except Exception as error:  # what a worker that is being closed raises depends on what it was doing
            problem = error
            plugin.idempotent = False  # a worker that was passed over must get it
            if client.status != "running":
                break
            time.sleep(pause)
    raise ClusterLostError(
        f"The workers cannot be prepared ({type(problem).__name__}: {problem})", address_of(client),
        "workers that stay for a while", "look at their logs, then run the same command again",
    ) from problem  # fmt: skip


@contextmanager
def _quiet() -> Iterator[None]:
    """Silences what Dask and asyncio log about lost connections: the run's own error says it in one sentence."""
    loggers = [logging.getLogger(name) for name in _NOISY]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def dask_settings() -> dict[str, Any]:
    """Dask's settings for long tasks that keep their pixels to themselves; `deploy/dask.yaml` says the same."""
    from yesnt.planning.stages import STAGES

    return {
        "distributed.scheduler.allowed-failures": 0,  # a death is counted by the driver, not by Dask
        "distributed.scheduler.work-stealing": False,  # the window holds one task a slot: nothing to steal
        "distributed.scheduler.no-workers-timeout": "120s",
        "distributed.scheduler.default-task-durations": {
            row.name: f"{row.cost.scheduler_seconds}s" for row in STAGES.values() if row.cost.scheduler_seconds
        },
        "distributed.worker.memory.target": False,  # receipts are small: there is nothing to spill
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.worker.memory.terminate": 0.95,
        "distributed.worker.memory.recent-to-old-time": "600s",
        "distributed.nanny.pre-spawn-environ": {**dict.fromkeys(THREAD_VARIABLES, "1"), **ALLOCATOR},
        "distributed.comm.timeouts.connect": f"{_CONNECT_SECONDS}s",
        "distributed.worker.use-file-locking": False,
        "distributed.admin.low-level-log-length": 0,
        # What Dask measures of itself many times a second costs a long run processor time and, slowly, memory.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "500ms",
        "distributed.admin.system-monitor.interval": "2s",
    }


@contextmanager
def _address(spec: ClusterSpec) -> Iterator[Any]:
    if spec.kind == "local":
        import dask

        with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}), _local(spec) as cluster:
            yield cluster
    else:
        check_kind(spec)
        yield spec.kind


@contextmanager
def _local(spec: ClusterSpec) -> Iterator[Any]:
    from distributed import LocalCluster

    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    try:
        cluster = LocalCluster(
            n_workers=spec.workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address=None,
            memory_limit=spec.memory or "auto",
            env={**os.environ, **WORKER_ENVIRONMENT},  # a forked worker would have that of the first run's time
            silence_logs=logging.CRITICAL,
        )
    except ImportError as error:  # bokeh is a dependency of ours, but a trimmed install may lack it
        raise MissingPartError("The dashboard's library is absent", str(error), "bokeh", "pip install bokeh") from error
    _restore(before)
    try:
        yield cluster
    finally:
        with suppress(TimeoutError):  # a crowded machine; the workers end with this process, and all work is recorded
            cluster.close(timeout=10)
        _restore(before)


def _restore(environment: dict[str, str | None]) -> None:
    """Undoes what Dask's nannies set for their children: it would stay set in this process."""
    for name, value in environment.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _close(client: Client) -> None:
    with suppress(OSError, TimeoutError):  # the scheduler may be what is lost, or too busy
        client.close(timeout=5)


def _prepare_plugin(modules: tuple[str, ...], compiles: bool) -> Any:
    from distributed import WorkerPlugin

    class Prepare(WorkerPlugin):
        """Prepares a worker before its first task, also one that replaces a dead worker.

        Pinning matters in workers that were started without our environment (a user's own cluster). These also compile
        the kernels; the workers of one host share that work.
        """

        name = "yesnt-prepare"
        idempotent = True

        async def setup(self, worker: Any) -> None:
            """Pins, then imports and compiles in a thread, so that the worker's heart beats meanwhile."""
            import asyncio

            del worker
            os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
            await asyncio.to_thread(import_all, modules)
            if compiles and modules:
                with suppress(Exception):  # a task compiles the kernel that it lacks, or says why it cannot
                    await asyncio.to_thread(compile_missing)
            pin_threads()

    return Prepare()


def import_all(modules: tuple[str, ...]) -> None:
    """Imports modules; one that is absent is left to the task that needs it, which can say what for."""
    for name in modules:
        with suppress(ImportError):
            importlib.import_module(name)
