"""Workers on this machine for one run, forked from one process that has imported everything."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from typing import Any

from yesnt.core.errors import MissingPartError
from yesnt.runtime.cluster.worker_settings import WORKER_ENVIRONMENT
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.table import CPU, GPU, Running


class LocalLauncher:
    """Processes of one thread; for a job of a GPU backend, also one process for each GPU of this machine."""

    def __init__(self, spec: ClusterSpec) -> None:
        self._spec = spec

    @property
    def pools(self) -> frozenset[str]:
        """CPU and GPU if the job needs both and GPUs are here; else nothing: every worker takes every task."""
        return frozenset({CPU, GPU}) if self._gpus else frozenset()

    @cached_property
    def _gpus(self) -> tuple[str, ...]:
        """Values of CUDA_VISIBLE_DEVICES, one a GPU; () if the job needs none or there is none."""
        if not self._spec.gpu:
            return ()
        import torch

        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        visible = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
        return tuple(visible[:count]) if len(visible) >= count > 0 and visible[0] else tuple(map(str, range(count)))

    def check(self) -> None:
        """Nothing can be wrong with this machine."""

    @contextmanager
    def open(self) -> Iterator[Running]:
        """Yields a LocalCluster on 127.0.0.1."""
        import dask

        before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
        with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
            cluster = self._start()
            restore_environment(before)
            try:
                yield Running(cluster)
            finally:
                with suppress(TimeoutError):  # a crowded machine; the workers end with this process, and all work
                    cluster.close(timeout=10)  # is recorded
                restore_environment(before)

    def _start(self) -> Any:
        from distributed import LocalCluster

        try:
            cluster = LocalCluster(
                n_workers=self._spec.workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                worker_dashboard_address=None,
                memory_limit=self._spec.memory or "auto",
                # a forked worker would have the environment of the first run's time
                env={**os.environ, **WORKER_ENVIRONMENT},
                silence_logs=logging.CRITICAL,
                resources={CPU: 1} if self._gpus else None,
            )
        except ImportError as error:  # bokeh is a dependency of ours, but a trimmed install may lack it
            raise MissingPartError(
                "The dashboard's library is absent", str(error), "bokeh", "pip install bokeh"
            ) from error
        self._add_gpu_workers(cluster)
        return cluster

    def _add_gpu_workers(self, cluster: Any) -> None:
        """Adds a process for each GPU, which sees that GPU alone; a model is loaded once on each."""
        if not self._gpus:
            return
        example = cluster.new_worker_spec()
        ((_, row),) = example.items()
        for device in self._gpus:
            options = dict(row["options"])
            options["env"] = {**options["env"], "CUDA_VISIBLE_DEVICES": device}
            options["resources"] = {GPU: 1}
            cluster.worker_spec[f"gpu-{device}"] = {**row, "options": options}
        cluster.sync(cluster._correct_state)


def restore_environment(environment: dict[str, str | None]) -> None:
    """Undoes what Dask's nannies set for their children: it would stay set in this process."""
    for name, value in environment.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
