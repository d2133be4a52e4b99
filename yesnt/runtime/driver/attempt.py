"""One attempt of a task on a worker; tells the driver which worker it was, also when it fails."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from yesnt.io.records import RecordBook
from yesnt.planning.graph import Node
from yesnt.runtime.driver.packed import Packed

_WORKER = "yesnt_worker"


def attempt(task: Callable[[Any, Node], dict[str, Any]], context: Packed, node: Node) -> dict[str, Any]:
    """Runs a task; the address of its worker is added to the receipt, or to the error."""
    try:
        return {**_without_exit(task, context.unpack(), node), "worker": _own_address()}
    except Exception as error:
        with suppress(AttributeError, TypeError):  # an error without attributes says nothing of its worker
            setattr(error, _WORKER, _own_address())
        raise


def _without_exit(task: Callable[[Any, Node], dict[str, Any]], context: Any, node: Node) -> dict[str, Any]:
    """Runs a task; `sys.exit` inside it is a failure like others: Dask would neither end the worker nor the task."""
    try:
        return task(context, node)
    except SystemExit as error:
        raise RuntimeError(f"a part of the task called sys.exit({error.code!r})") from error


def worker_of(error: BaseException | None) -> str:
    """The worker that a task failed on, or that died with it; "" if it is not known."""
    last = getattr(error, "last_worker", None)  # of Dask's KilledWorker
    return str(getattr(error, _WORKER, None) or getattr(last, "address", None) or "")


def recorded(book: RecordBook, node: Node) -> dict[str, Any]:
    """A receipt made from the commit record, for a task whose worker died after it had committed."""
    record = book.find(node.stage, node.frames[-1])
    seconds, facts = ({}, {}) if record is None else (record.seconds, record.facts)
    return {
        "seconds": seconds.get("task", 0.0),
        "kernel_seconds": seconds.get("kernel", 0.0),
        "peak_bytes": facts.get("peak_bytes", 0),
        "pid": 0,  # not known
    }


def _own_address() -> str:
    from distributed import get_worker

    with suppress(ValueError):  # outside of a worker
        return str(get_worker().address)
    return ""
