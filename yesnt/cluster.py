"""Clusters: a local one by default, or one that runs already; loopback only unless the user says otherwise."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from yesnt.errors import ClusterLostError, MissingPartError, UsageError

if TYPE_CHECKING:
    from distributed import Client

THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "BLOSC_NTHREADS", "OPENIMAGEIO_THREADS", "OPENEXR_THREADS",
)  # fmt: skip
"""Variables that pin libraries to one thread; they act only if set before the library starts."""

_CONNECT_SECONDS = 20


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


@contextmanager
def open_cluster(spec: ClusterSpec) -> Iterator[Client]:
    """Yields a client whose workers have one thread each, with every library pinned to it.

    Raises:
        UsageError: the kind is unknown, or a scheduler off this machine is asked for without TLS.
        ClusterLostError: the scheduler does not answer.
        MissingPartError: the kind needs an extra that is absent.
    """
    import dask
    from distributed import Client

    with dask.config.set(_settings()):
        with _address(spec) as address:
            try:
                client = Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
            except (OSError, TimeoutError) as error:
                raise ClusterLostError(
                    "The scheduler does not answer",
                    str(address),
                    "a running Dask scheduler",
                    "start it, then run again",
                ) from error
            try:
                client.register_plugin(_pin_plugin())
                yield client
            finally:
                _close(client)


def pin_threads() -> dict[str, int]:
    """Pins every library in this process to one thread; returns what each says of itself.

    Libraries that are not used yet are left to the environment of the worker, so that nothing is imported for this;
    the environment of a process that is not ours (a notebook, a test) is not touched.
    """
    import sys

    counts: dict[str, int] = {}
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(1)
        counts["torch"] = torch.get_num_threads()
    if (numba := sys.modules.get("numba")) is not None:
        numba.set_num_threads(1)
        counts["numba"] = numba.get_num_threads()
    if (cv2 := sys.modules.get("cv2")) is not None:
        cv2.setNumThreads(1)
        counts["opencv"] = cv2.getNumThreads()
    if (oiio := sys.modules.get("OpenImageIO")) is not None:
        oiio.attribute("threads", 1)
        oiio.attribute("exr_threads", -1)  # -1: none beside the caller's own
        counts["openimageio"] = oiio.get_int_attribute("threads")
    if (openexr := sys.modules.get("OpenEXR")) is not None:
        openexr.set_global_thread_count(0)  # 0: none beside the caller's own
        counts["openexr"] = openexr.global_thread_count()
    return counts


def _settings() -> dict[str, Any]:
    """Dask's settings for long tasks that keep their pixels to themselves."""
    return {
        "distributed.scheduler.allowed-failures": 0,  # a death is counted by the driver, not by Dask
        "distributed.scheduler.work-stealing": False,  # the window holds one task a slot: nothing to steal
        "distributed.scheduler.no-workers-timeout": "120s",
        "distributed.scheduler.default-task-durations": {
            "decompose": "5s",
            "flow": "1s",
            "solve": "5s",
            "relight": "5s",
        },
        "distributed.worker.memory.target": False,  # receipts are small: there is nothing to spill
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.worker.memory.terminate": 0.95,
        "distributed.worker.memory.recent-to-old-time": "600s",
        "distributed.nanny.pre-spawn-environ": {
            **dict.fromkeys(THREAD_VARIABLES, "1"),
            "MALLOC_TRIM_THRESHOLD_": 65536,
        },
        "distributed.comm.timeouts.connect": f"{_CONNECT_SECONDS}s",
        "distributed.worker.use-file-locking": False,
        "distributed.admin.low-level-log-length": 0,
    }


@contextmanager
def _address(spec: ClusterSpec) -> Iterator[Any]:
    if spec.kind == "local":
        with _local(spec) as cluster:
            yield cluster
    elif spec.kind.startswith("tls://") or spec.kind.startswith(("tcp://127.", "tcp://localhost", "tcp://[::1]")):
        yield spec.kind
    elif spec.kind.startswith("tcp://"):
        raise UsageError(
            "A scheduler on another machine must use TLS: whoever reaches it runs code",
            f"--cluster {spec.kind}", "tls://HOST:PORT", "start the scheduler with TLS, or tunnel it to 127.0.0.1",
        )  # fmt: skip
    else:
        raise UsageError(
            f"No cluster of the kind {spec.kind!r}", "--cluster", "local, tcp://127.0.0.1:PORT or tls://HOST:PORT",
            "start workers by your farm's own means and give the scheduler's address (deploy/)",
        )  # fmt: skip


@contextmanager
def _local(spec: ClusterSpec) -> Iterator[Any]:
    import logging

    from distributed import LocalCluster

    try:
        cluster = LocalCluster(
            n_workers=spec.workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address=None,
            memory_limit=spec.memory or "auto",
            silence_logs=logging.CRITICAL,
        )
    except ImportError as error:  # bokeh is a dependency of ours, but a trimmed install may lack it
        raise MissingPartError("The dashboard's library is absent", str(error), "bokeh", "pip install bokeh") from error
    try:
        yield cluster
    finally:
        cluster.close(timeout=10)


def _close(client: Client) -> None:
    try:
        client.close(timeout=5)
    except (OSError, TimeoutError):  # the scheduler may be what is lost
        pass


def _pin_plugin() -> Any:
    from distributed import WorkerPlugin

    class PinThreads(WorkerPlugin):
        """Pins libraries in a worker that was started without our environment (a user's own cluster)."""

        name = "yesnt-pin-threads"
        idempotent = True

        def setup(self, worker: Any) -> None:
            """Runs in each worker when it joins, before it has imported what the variables are for."""
            del worker
            os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
            pin_threads()

    return PinThreads()
