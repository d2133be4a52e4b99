"""Prepares workers before their first task: imports, compiled kernels, one thread each."""

from __future__ import annotations

import importlib
import os
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import ClusterLostError
from yesnt.core.threads import THREAD_VARIABLES, pin_threads
from yesnt.runtime.cluster.precompile import compile_missing

if TYPE_CHECKING:
    from distributed import Client

_PREPARE_PAUSES = (0.5, 1.0, 2.0, 4.0, 4.0, 4.0)
"""Seconds after a failed attempt to prepare the workers; in that time a worker that restarts is back."""


def prepare_workers(client: Client, plugin: Any) -> None:
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
        f"The workers cannot be prepared ({type(problem).__name__}: {problem})",
        str(getattr(client.scheduler, "address", "")),
        "workers that stay for a while", "look at their logs, then run the same command again",
    ) from problem  # fmt: skip


def prepare_plugin(modules: tuple[str, ...], compiles: bool, stages: frozenset[str] | None = None) -> Any:
    """The plugin that prepares each worker.

    Args:
        modules: what a worker imports.
        compiles: whether it also compiles kernels that are missing on its host.
        stages: whose kernels; None: those of all.
    """
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
                    await asyncio.to_thread(compile_missing, stages)
            pin_threads()

    return Prepare()


def import_all(modules: tuple[str, ...]) -> None:
    """Imports modules; one that is absent is left to the task that needs it, which can say what for."""
    for name in modules:
        with suppress(ImportError):
            importlib.import_module(name)
