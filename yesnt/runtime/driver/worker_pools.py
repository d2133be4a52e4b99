"""CPU and GPU workers: which of them a stage's tasks may go to, and how many at a time.

A worker belongs to a pool if it offers Dask resources named `CPU` or `GPU`. Workers that offer neither take every task.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping

from yesnt.core.errors import UsageError
from yesnt.runtime.launchers.table import CPU, GPU

ANY = ""
"""Pool of the stages whose tasks every worker may take."""

ABSENT_SECONDS = 4.0
"""A pool without workers for this long is reported to the user."""


class WorkerPools:
    """Pools of one run.

    Args:
        gpu_stages: stages that call a network that is made for a GPU.
        expected: pools that the cluster's launcher starts; empty: unknown.
    """

    def __init__(self, gpu_stages: Collection[str] = (), expected: Collection[str] = ()) -> None:
        self._gpu_stages, self._expected = frozenset(gpu_stages), frozenset(expected)
        self._workers: dict[str, dict[str, int]] = {}
        self._absent_since: float | None = None
        self._told = False

    @property
    def divided(self) -> bool:
        """Whether the job has GPU tasks, so that it matters what the workers offer."""
        return bool(self._gpu_stages)

    def update(self, resources: Mapping[str, Mapping[str, float]]) -> None:
        """Takes what the workers offer.

        Args:
            resources: by the worker's address.

        Raises:
            UsageError: the job needs a GPU, and the workers of a cluster that was started elsewhere offer none.
        """
        self._workers = {}
        for worker, offered in resources.items():
            for pool in (CPU, GPU):
                if int(offered.get(pool, 0)):
                    self._workers.setdefault(pool, {})[worker] = int(offered[pool])
        if self.divided and not self._expected and CPU in self._workers and GPU not in self._workers:
            raise UsageError(
                "No worker of the cluster offers a GPU, and the job's decomposition backend is made for one",
                "the workers' resources", "at least one worker with `--resources GPU=1`",
                "start one, or start all workers without resources if the backend is to run on them (slowly)",
            )  # fmt: skip

    def pool_of(self, stage: str) -> str:
        """The resource that a stage's tasks ask for; "" if every worker may take them."""
        wanted = GPU if stage in self._gpu_stages else CPU
        return wanted if self.divided and (wanted in self._workers or wanted in self._expected) else ANY

    def has_room(self, stage: str, running: Iterable[str]) -> bool:
        """Whether the stage's pool has a free slot.

        Args:
            stage: of the task that would start.
            running: stages of the tasks under way.
        """
        pool = self.pool_of(stage)
        return pool == ANY or sum(self.pool_of(other) == pool for other in running) < self._slots(pool)

    def workers_of(self, stage: str, workers: Mapping[str, int]) -> Mapping[str, int]:
        """Those of the workers that may take the stage's tasks."""
        pool = self.pool_of(stage)
        return workers if pool == ANY else {w: n for w, n in workers.items() if w in self._workers.get(pool, {})}

    def newly_absent(self, stages: Iterable[str]) -> str:
        """What is missing, if stages with work have had no worker for a while; told once each time, else ""."""
        absent = sorted({self.pool_of(stage) for stage in stages if self._slots(self.pool_of(stage)) == 0})
        if not absent or not self._workers:  # without any worker, the whole run waits, and that is told elsewhere
            self._absent_since, self._told = None, False
            return ""
        now = time.monotonic()
        self._absent_since = now if self._absent_since is None else self._absent_since
        if self._told or now - self._absent_since < ABSENT_SECONDS:
            return ""
        self._told = True
        return f"no {' or '.join(absent)} worker has joined; the tasks for it wait, all others go on"

    def _slots(self, pool: str) -> int:
        """Tasks that a pool takes at a time; unlimited where every worker takes them."""
        return 1 << 30 if pool == ANY else sum(self._workers.get(pool, {}).values())
