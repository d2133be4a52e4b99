"""What a run leaves for others to read: the event log, and a small file with the state of its driver."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from yesnt.core.errors import LeaseLostError, RunCancelledError, YesntError
from yesnt.io.durable import is_full
from yesnt.io.file_digests import save_memory
from yesnt.io.lease import Lease
from yesnt.io.process_identity import ProcessIdentity

Listener = Callable[[Mapping[str, Any]], None]

MOST_PENDING = 100_000
"""Events that are kept in memory while the disk is full; further ones are counted and not kept."""


class EventStream:
    """Appends events to a log, one JSON object a line; a full disk delays them and never leaves part of a line.

    Args:
        path: the log.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._pending: list[bytes] = []
        self._dropped = 0

    def write(self, event: Mapping[str, Any]) -> None:
        """Appends an event, after those that a full disk has delayed."""
        if len(self._pending) < MOST_PENDING:
            self._pending.append(json.dumps(event, default=str).encode() + b"\n")
        else:
            self._dropped += 1
        if self._append(b"".join(self._pending)):
            self._pending.clear()
            if self._dropped:
                dropped, self._dropped = self._dropped, 0
                self.write({"event": "dropped", "time": time.time(), "count": dropped})

    def close(self) -> None:
        """Ends the log."""
        os.close(self._file)

    def _append(self, data: bytes) -> bool:
        size = os.fstat(self._file).st_size
        try:
            whole = os.write(self._file, data) == len(data)
        except OSError as error:
            if not is_full(error):
                raise
            whole = False
        if not whole:
            os.ftruncate(self._file, size)
        return whole


class RunLog:
    """Follows the events of one run; used through `open_run_log`.

    Attributes:
        run: identifier of the run.
        state: as the state file holds it (see docs/runs.md).

    Args:
        path: the state file, `out/run/state.json`.
        lease: of the driver.
        submission: identifier of the submission that started it; "" if the user did.
    """

    def __init__(self, path: Path, lease: Lease, submission: str) -> None:
        self._path, self._lease, self.run = path, lease, lease.nonce
        owner = ProcessIdentity.own()
        self.state: dict[str, Any] = {
            "run": self.run, "submission": submission, "host": owner.host, "pid": owner.pid, "began": time.time(),
            "state": "running", "by": "", "shortages": {}, "blocked_hosts": {}, "taken_over": "", "dashboard": "",
            "page": "", "exit_status": None, "error": "",
        }  # fmt: skip

    def apply(self, event: Mapping[str, Any]) -> None:
        """Takes one event; those that concern the run as a whole change its state file."""
        kind, state = event["event"], self.state
        if kind in ("paused", "resumed"):
            state |= {"state": "paused" if kind == "paused" else "running", "by": event["by"]}
        elif kind == "shortage":
            state["shortages"] = {**state["shortages"], event["stage"]: event["reason"]}
        elif kind == "shortage_over":
            state["shortages"] = {s: why for s, why in state["shortages"].items() if s != event["stage"]}
        elif kind == "host_blocked":
            state["blocked_hosts"] = {**state["blocked_hosts"], event["host"]: event["reason"]}
        elif kind == "taken_over":
            state["taken_over"] = event["owner"]
        elif kind == "cluster":
            state |= {"dashboard": event["dashboard"], "page": event.get("page", "")}
        else:
            return
        self.save()

    def end(self, error: BaseException | None, missing: int) -> None:
        """The run is over, with an error or with frames that are missing."""
        status = getattr(error, "exit_status", 130 if isinstance(error, KeyboardInterrupt) else 1)
        how = "cancelled" if isinstance(error, RunCancelledError | KeyboardInterrupt) else "failed"
        if error is None:
            status, how = (3 if missing else 0), "ended"
        told = str(error) if isinstance(error, YesntError) else "" if error is None else repr(error)
        self.state |= {"state": how, "exit_status": status, "error": told, "shortages": {}, "ended": time.time()}
        if not isinstance(error, LeaseLostError):  # else the file is another driver's
            self.save()

    def save(self) -> None:
        """Writes the state file."""
        save_memory(self._path, self.state)


@contextmanager
def open_run_log(log: RunLog, events: Path, listeners: tuple[Listener, ...]) -> Iterator[Listener]:
    """Yields what takes every event: it goes to the event log, the state file and the listeners.

    Args:
        log: the state.
        events: the event log.
        listeners: called in this order.
    """
    stream = EventStream(events)

    def tell(event: Mapping[str, Any]) -> None:
        stream.write(event)
        log.apply(event)
        for listen in listeners:
            listen(event)

    log.save()
    try:
        tell({"event": "run", "time": time.time(), "run": log.run})
        yield tell
    finally:
        stream.close()
