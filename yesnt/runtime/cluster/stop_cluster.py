"""Ends what a run started: in order when it is done, at once when the user interrupts it."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

CLOSE_SECONDS = 2
"""How long an interrupted run waits for its scheduler and client to close."""


@contextmanager
def children_without_interrupt() -> Iterator[None]:
    """Processes that start inside never see SIGINT: a terminal sends Ctrl-C to them too, but only the driver answers.

    The signal is blocked, which a child inherits; one that comes meanwhile is delivered afterwards.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_quiet_tracker() -> None:
    """Starts multiprocessing's resource tracker, which removes semaphores that a killed process leaves, without a word.

    It must start before `children_without_interrupt`, since its start unblocks SIGINT.
    """
    from multiprocessing import resource_tracker

    before = list(sys.warnoptions)
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")  # child processes get the options of this one
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions[:] = before


def kill_children() -> None:
    """Kills all processes that this one has started, but for the one that removes their semaphores."""
    import psutil

    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            if not any("resource_tracker" in word for word in child.cmdline()):
                child.kill()


def stop_now(client: Any) -> None:
    """Kills the workers of a local cluster and closes it; of a cluster that was started elsewhere only the connection.

    Nothing is lost but the tasks under way: files get their names only when they are whole.
    """
    warnings.simplefilter("ignore")  # the process ends: of coroutines that were never awaited, and the like
    cluster = client.cluster
    for nanny in getattr(cluster, "workers", {}).values():
        nanny.auto_restart = False
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
    with suppress(OSError, TimeoutError):
        client.close(timeout=CLOSE_SECONDS)
    if cluster is not None:
        with suppress(OSError, TimeoutError):
            cluster.close(timeout=CLOSE_SECONDS)
