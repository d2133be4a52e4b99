"""Tasks that have ended, as the client's event loop learns of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from yesnt.planning.graph import NodeId

if TYPE_CHECKING:
    from distributed import Client


class Completions:
    """Futures that are waited for; those that ended are taken in batches.

    `Future.add_done_callback` would wake a thread of Dask's for each task, which costs as much as sending it.

    Args:
        client: that the futures belong to.
    """

    def __init__(self, client: Client) -> None:
        from distributed import as_completed

        self._completed = as_completed(loop=client.loop)
        self._ids: dict[Any, NodeId] = {}

    def add(self, node_id: NodeId, future: Any) -> None:
        """Waits for a task's future too."""
        self._ids[future.key] = node_id
        self._completed.add(future)

    def take(self, seconds: float) -> list[tuple[NodeId, Any]]:
        """Tasks that have ended since the last call, with their futures; waits at most so long for the first."""
        with self._completed.thread_condition:
            if not self._completed.has_ready():
                self._completed.thread_condition.wait(seconds)
        return [(self._ids.pop(future.key), future) for future in self._completed.next_batch(block=False)]
