"""Settings of Dask, of the memory allocator and of thread counts that all workers share, wherever they start."""

from __future__ import annotations

from typing import Any

from yesnt.core.threads import THREAD_VARIABLES

CONNECT_SECONDS = 20

ALLOCATOR = {
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(512 << 20), "MALLOC_ARENA_MAX": "1",
}  # fmt: skip
"""A worker keeps freed pages for its next frame. Dask's own setting (trim at 64 kB) returns every large array to the
kernel and faults it in again: 43 % of the processor time of decomposition, for 4 % less memory."""

WORKER_ENVIRONMENT = {**dict.fromkeys(THREAD_VARIABLES, "1"), **ALLOCATOR, "PYTHONHASHSEED": "6640"}
"""Environment of workers and of the process that local ones are forked from; the hash seed is Dask's default."""


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
        "distributed.comm.timeouts.connect": f"{CONNECT_SECONDS}s",
        "distributed.worker.use-file-locking": False,
        "distributed.admin.low-level-log-length": 0,
        # What Dask measures of itself many times a second costs a long run processor time and, slowly, memory.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "500ms",
        "distributed.admin.system-monitor.interval": "2s",
    }
