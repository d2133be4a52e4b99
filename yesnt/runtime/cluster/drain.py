"""Lets a worker finish what it is doing before its job's time is over (Dask's `--preload`).

Dask's own `--lifetime` closes a worker while its task runs, and the task is made again elsewhere. Here the worker is
paused first: it gets no new task, finishes its last one, and leaves.
"""

from __future__ import annotations

import asyncio
import os
import time
from functools import partial
from typing import Any

DRAIN_AT = "YESNT_DRAIN_AT"
"""Environment variable: when the worker takes no more tasks, in seconds since the epoch by its own host's clock."""

POLL_SECONDS = 0.5

FETCH_SECONDS = 3.0
"""Time for the driver to fetch the receipt of the last task."""


def dask_setup(worker: Any) -> None:
    """Called by Dask when the worker starts."""
    at = os.environ.get(DRAIN_AT)
    if at:
        worker.loop.call_later(max(0.0, float(at) - time.time()), partial(drain, worker))


async def drain(worker: Any) -> None:
    """Takes no new task, waits for the one that runs, then closes the worker and its nanny."""
    from distributed.core import Status

    worker.status = Status.paused
    while worker.state.all_running_tasks:
        await asyncio.sleep(POLL_SECONDS)
    await asyncio.sleep(FETCH_SECONDS)
    await worker.close_gracefully(restart=False, reason="its job's time is nearly over")
