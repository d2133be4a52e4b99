"""Which hosts tasks fail on: a failed task is tried elsewhere, and a host that fails many frames gets no more."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from yesnt.planning.graph import NodeId
from yesnt.runtime.driver.scheduler_watch import host_of

DISTINCT_FRAMES = 3
"""A host is blocked when so many different tasks in a row have failed on it, with none that succeeded between."""


class HostFailures:
    """Counts failures by host, for one run.

    Attributes:
        blocked: host -> why it gets no more tasks.
    """

    def __init__(self) -> None:
        self.blocked: dict[str, str] = {}
        self._in_a_row: dict[str, list[NodeId]] = {}
        self._failed_on: dict[NodeId, set[str]] = {}

    def succeeded(self, worker: str) -> None:
        """A task ended well on a worker."""
        self._in_a_row.pop(host_of(worker), None)

    def failed(self, node_id: NodeId, worker: str, reason: str, workers: Iterable[str]) -> str:
        """A task failed on a worker.

        Returns:
            The host, if it is blocked from now on; else "". The last host of a cluster never is.
        """
        host, hosts = host_of(worker), {host_of(one) for one in workers}
        self._failed_on.setdefault(node_id, set()).add(host)
        row = self._in_a_row.setdefault(host, [])
        if node_id not in row:
            row.append(node_id)
        if len(row) < DISTINCT_FRAMES or host in self.blocked or not hosts - {host} - self.blocked.keys():
            return ""
        self.blocked[host] = f"{len(row)} different frames in a row failed on it, the last with: {reason}"
        return host

    def elsewhere(self, node_id: NodeId, workers: Collection[str]) -> list[str] | None:
        """Workers that a task may go to: none of a blocked host or, if possible, of a host that it failed on.

        Returns:
            None if all may take it.
        """
        if not self.blocked and node_id not in self._failed_on:
            return None  # asked for every task: looking at hundreds of workers each time would cost more than the task
        allowed = [worker for worker in workers if host_of(worker) not in self.blocked]
        fresh = [worker for worker in allowed if host_of(worker) not in self._failed_on.get(node_id, ())]
        chosen = fresh or allowed
        return None if not chosen or len(chosen) == len(workers) else chosen

    def untried(self, node_id: NodeId, workers: Iterable[str]) -> bool:
        """Whether there is a host that is not blocked and that the task has not failed on."""
        hosts = {host_of(worker) for worker in workers}
        return bool(hosts - self.blocked.keys() - self._failed_on.get(node_id, set()))
