"""Opens the cluster of a run: starts or finds its scheduler, connects, prepares the workers."""

from __future__ import annotations

import getpass
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from yesnt.core.errors import ClusterLostError, RunCancelledError
from yesnt.runtime.cluster.prepare_workers import prepare_plugin, prepare_workers
from yesnt.runtime.cluster.stop_cluster import children_without_interrupt, start_quiet_tracker, stop_now
from yesnt.runtime.cluster.worker_settings import CONNECT_SECONDS, WORKER_ENVIRONMENT, dask_settings
from yesnt.runtime.launchers.local import restore_environment
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.table import Running, launched

if TYPE_CHECKING:
    from distributed import Client

_NOISY = (
    "asyncio", "tornado.application", "distributed", "distributed.client", "distributed.core", "distributed.comm",
    "distributed.nanny", "distributed.scheduler", "distributed.worker", "distributed.utils", "distributed.batched",
)  # fmt: skip
"""Loggers that tell of lost connections, with tracebacks."""


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
        restore_environment(before)


@contextmanager
def open_cluster(
    spec: ClusterSpec, modules: tuple[str, ...] = (), stages: frozenset[str] | None = None
) -> Iterator[Client]:
    """Yields a client whose workers have one thread each, with every library pinned to it.

    Args:
        spec: where tasks run.
        modules: what each worker imports before its first task.
        stages: whose kernels workers of a cluster that was started elsewhere compile; None: those of all.

    Raises:
        UsageError: the kind is unknown, or a scheduler off this machine is asked for without TLS.
        ClusterLostError: the scheduler does not answer.
        MissingPartError: the kind needs an extra that is absent.
    """
    import dask
    import distributed  # noqa: F401 - it sets up its loggers, which are silenced below

    with dask.config.set(dask_settings()), _quiet(), launched(spec) as running, _dashboard(running):
        client = _connect(running)
        try:
            prepare_workers(client, prepare_plugin(modules, spec.kind != "local", stages))
            yield client
        except (KeyboardInterrupt, RunCancelledError):
            stop_now(client)
            raise
        except ClusterLostError as error:  # the launcher may know why
            if (problem := running.problem()) is not None:
                raise problem from error
            raise
        finally:
            _close(client)


def _connect(running: Running) -> Client:
    from distributed import Client

    try:
        return Client(running.address, security=running.security, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise ClusterLostError(
            "The scheduler does not answer",
            str(running.address),
            "a running Dask scheduler",
            "start it, then run again",
        ) from error


def _dashboard(running: Running) -> AbstractContextManager[Any]:
    """Makes Dask say where the dashboard is, if the launcher knows better than the scheduler's own address."""
    import dask

    return dask.config.set({"distributed.dashboard.link": running.dashboard}) if running.dashboard else nullcontext()


def tunnel_to(dashboard: str) -> str:
    """The command that makes a dashboard of this machine reachable from another one under the same address."""
    port = urlsplit(dashboard).port
    return f"ssh -N -L {port}:127.0.0.1:{port} {getpass.getuser()}@{socket.getfqdn()}" if port else ""


def dashboard_of(client: Client) -> str:
    """Address of the scheduler's dashboard; "" if it has none."""
    try:
        return str(client.dashboard_link or "")
    except (AttributeError, KeyError, OSError, TimeoutError, ValueError):  # no dashboard, or the scheduler is gone
        return ""


def address_of(client: Client) -> str:
    """Address of the scheduler; "" if the connection is lost (the driver notices)."""
    return str(getattr(client.scheduler, "address", ""))


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


def _close(client: Client) -> None:
    with suppress(OSError, TimeoutError):  # the scheduler may be what is lost, or too busy
        client.close(timeout=5)
