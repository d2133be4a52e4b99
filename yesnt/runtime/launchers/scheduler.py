"""A scheduler in the driver's process that workers of other machines reach over TLS."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from yesnt.core.errors import UsageError
from yesnt.runtime.launchers.certificates import Certificate

DASHBOARD = "127.0.0.1:0"
"""TLS does not protect Dask's dashboard, so it is bound to this machine alone; a tunnel reaches it from elsewhere."""


@contextmanager
def scheduler_here(certificate: Certificate, interface: str | None, host: str | None) -> Iterator[Any]:
    """Yields Dask's cluster object of a scheduler without workers, which listens with TLS.

    Args:
        certificate: that workers and client must show.
        interface: network interface to listen on; None: that of `host`, or of this machine's default route.
        host: address to listen on.

    Raises:
        UsageError: there is no such interface or address.
    """
    import dask
    from distributed import Scheduler, SpecCluster
    from distributed.utils import get_ip

    where = {"interface": interface} if interface else {"host": host or get_ip()}
    options = {"protocol": "tls://", "dashboard_address": DASHBOARD, "security": certificate.security(), **where}
    # Workers may wait long in a farm's queue; the launcher notices if they fail.
    with dask.config.set({"distributed.scheduler.no-workers-timeout": None}):
        try:
            cluster = SpecCluster(
                workers={}, scheduler={"cls": Scheduler, "options": options}, security=certificate.security(),
                silence_logs=logging.CRITICAL,
            )  # fmt: skip
        except (RuntimeError, ValueError, OSError) as error:
            raise UsageError(
                f"The scheduler cannot listen ({error})", "keys interface and host of the cluster profile",
                "an interface or address of this machine that workers reach", "correct the profile",
            ) from error  # fmt: skip
        try:
            yield cluster
        finally:
            with suppress(TimeoutError, OSError):
                cluster.close(timeout=10)


def dashboard_address(cluster: Any) -> str:
    """Address of the dashboard, which this machine alone reaches; "" if Dask could not start it."""
    port = cluster.scheduler_info.get("services", {}).get("dashboard")
    return f"http://127.0.0.1:{port}/status" if port else ""


class Joined:
    """Names of the workers that are connected, and of all that ever were.

    Attributes:
        ever: all names so far, also of workers that left at once.
    """

    def __init__(self, cluster: Any) -> None:
        from distributed import SchedulerPlugin

        self._scheduler, self.ever = cluster.scheduler, set[str]()
        names = self.ever

        class Noted(SchedulerPlugin):
            """Notes each worker that joins."""

            name = "yesnt-joined"

            def add_worker(self, scheduler: Any, worker: str) -> None:
                """Called by the scheduler with the address of a worker that has joined."""
                names.add(str(scheduler.workers[worker].name))

        self._scheduler.add_plugin(Noted(), name=Noted.name)

    def now(self) -> set[str]:
        """Names of the workers that are connected."""
        return {str(worker.name) for worker in list(self._scheduler.workers.values())}
