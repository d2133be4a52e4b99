"""The cluster of a run, which starts in the background while inputs are checked."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from typing import Any

from yesnt.core.errors import RunCancelledError
from yesnt.runtime.cluster.open_cluster import address_of, dashboard_of, open_cluster, tunnel_to, warm_up
from yesnt.runtime.cluster.precompile import Precompilation
from yesnt.runtime.cluster.stop_cluster import stop_now
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.live_grid import frame_grid_of

Listener = Callable[[Mapping[str, Any]], None]

CHECK_SECONDS = 0.5


class LazyCluster:
    """A cluster that starts in the background, and only if there is something to run.

    The kernels of local workers are compiled in the same time, each once.

    Args:
        spec: where tasks run.
        modules: what each worker imports before its first task.
        stages: whose kernels are compiled.
    """

    def __init__(self, spec: ClusterSpec, modules: tuple[str, ...], stages: frozenset[str]) -> None:
        self.spec, self._modules, self._stages, self._stack = spec, modules, stages, ExitStack()
        self._starter = ThreadPoolExecutor(2, "yesnt-cluster")
        self._started: Future[Any] | None = None
        self._told = False
        self._compiled: Future[None] | None = None
        self._compiling: Precompilation | None = None
        self.dashboard = ""

    def begin(self, listen: Listener) -> None:
        """Starts the workers and compiles kernels in the background; errors are raised by `client`."""
        if self._started is None:
            if self.spec.kind == "local":
                self._compiling = Precompilation(self._stages)
                self._compiled = self._starter.submit(self._compiling.wait, listen)
            warm_up(self.spec, self._modules)
            self._started = self._starter.submit(
                lambda: self._stack.enter_context(open_cluster(self.spec, self._modules, self._stages))
            )

    def client(self, tell: Listener, check: Callable[[], None] = lambda: None) -> Any:
        """The client, started if need be.

        Args:
            tell: called with events.
            check: called twice a second while it starts; what it raises ends the wait.
        """
        self.begin(tell)
        assert self._started is not None
        for started in (self._started, self._compiled):
            while started is not None and not wait([started], CHECK_SECONDS).done:
                check()
        client = self._started.result()
        if self._compiled is not None:
            self._compiled.result()
        if not self._told:
            self.dashboard, self._told = dashboard_of(client), True
            tunnel = tunnel_to(self.dashboard) if self.spec.profile is not None else ""
            page = frame_grid_of(self.dashboard)
            tell({"event": "cluster", "dashboard": self.dashboard, "page": page, "tunnel": tunnel,
                  "scheduler": address_of(client)})  # fmt: skip
        return client

    def __enter__(self) -> LazyCluster:
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: Any) -> None:
        """Stops the compilers and the workers, if there are any; at once if the user interrupts or cancels the run."""
        if self._compiling is not None:
            self._compiling.close()
        if kind is None or not issubclass(kind, KeyboardInterrupt | RunCancelledError):
            self._starter.shutdown(wait=True)
            self._stack.__exit__(kind, *rest)  # the launcher may know better why a cluster was lost
            return
        warnings.simplefilter("ignore")  # the process ends: of coroutines that were never awaited, and the like
        self._starter.shutdown(wait=False)
        if self._started is not None and self._started.done():
            self._stack.__exit__(kind, *rest)
        elif self._started is not None:
            self._started.add_done_callback(_stop_late)


def _stop_late(started: Future[Any]) -> None:
    """Stops a cluster that was still starting when the run was interrupted."""
    if started.exception() is None:
        stop_now(started.result())
