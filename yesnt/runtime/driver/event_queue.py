"""Events of the driver in the order in which they happened; receipts of finished tasks are fetched together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from yesnt.planning.graph import Node
from yesnt.runtime.driver.scheduler_watch import GATHER_SECONDS, LOSS_SECONDS, lost

FLUSH_SECONDS = 1.0
"""Events are passed on this often. A receipt costs a round trip through the scheduler; a batch of them costs one."""

Receipt = dict[str, Any]


class EventQueue:
    """Holds events back until the receipts are there that some of them are waiting for.

    Args:
        listen: called with every event, in order.
        receive: called with each finished node and its receipt before its event; None where the receipt died with its
            worker. Returns what the event holds.
    """

    def __init__(
        self, listen: Callable[[Mapping[str, Any]], None], receive: Callable[[Node, Receipt | None], Receipt]
    ) -> None:
        self._listen, self._receive = listen, receive
        self._waiting: list[tuple[dict[str, Any], Node | None, Any]] = []
        self._flushed = time.monotonic()

    def tell(self, event: str, node: Node, **facts: Any) -> None:
        """Adds an event of a task."""
        self._waiting.append((_event(event, node, facts), None, None))

    def done(self, node: Node, future: Any) -> None:
        """Adds the end of a task; its receipt is the future's result."""
        self._waiting.append((_event("done", node, {}), node, future))

    def flush(self, client: Any, at_once: bool = False) -> None:
        """Tells what happened, if it is time.

        Args:
            client: fetches receipts; None: without them, since the scheduler may be gone.
            at_once: without waiting for the time.

        Raises:
            ClusterLostError: the scheduler is gone.
        """
        if not self._waiting or not (at_once or time.monotonic() - self._flushed >= FLUSH_SECONDS):
            return
        waiting, self._waiting = self._waiting, []
        receipts: dict[int, Receipt | None] = {}
        try:
            if client is not None:
                receipts = _fetch(client, {i: row[2] for i, row in enumerate(waiting) if row[1] is not None})
        finally:
            for i, (event, node, _) in enumerate(waiting):
                self._listen(event if node is None else {**event, **self._receive(node, receipts.get(i))})
            self._flushed = time.monotonic()


def _event(event: str, node: Node, facts: Mapping[str, Any]) -> dict[str, Any]:
    return {"event": event, "time": time.time(), "stage": node.stage.label, "frames": list(node.frames), **facts}


def _fetch(client: Any, futures: dict[int, Any]) -> dict[int, Receipt | None]:
    """Receipts by the same numbers; None for one that is lost, none at all if the scheduler takes too long."""
    from concurrent.futures import CancelledError

    from distributed.client import FutureCancelledError

    if not futures:
        return {}

    async def gather() -> dict[int, Receipt | None]:
        found: dict[int, Receipt | None] = await client.gather(futures, errors="skip", asynchronous=True)
        return found

    try:
        patience = LOSS_SECONDS + GATHER_SECONDS * len(futures)
        return dict(client.sync(gather, callback_timeout=patience))
    except (FutureCancelledError, CancelledError) as error:
        raise lost("its futures are cancelled") from error
    except TimeoutError:  # a worker died with its receipts; their records say nearly the same
        return {}
