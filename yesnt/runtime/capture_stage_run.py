"""Renders sets of the virtual capture stage as tasks of the same driver: a Blender a slot, a record a job."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.capture_stage.render import find_receipt, render
from yesnt.capture_stage.tools import Tools
from yesnt.io.records import Record, RecordBook
from yesnt.planning.graph import Node
from yesnt.planning.task_records import RenderTask
from yesnt.runtime.cluster.open_cluster import address_of, dashboard_of, open_cluster
from yesnt.runtime.driver.driver import Driver, DriverSettings, Outcome
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.table import check_cluster
from yesnt.tasks.memory import peak_bytes
from yesnt.workflows.capture_stage import capture_stage_graph

Listener = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True)
class CaptureStageContext:
    """Sent with every render task: the root of all sets, and the programs that render.

    Attributes:
        out: the root; of fits the folder of the evaluation that holds them.
        tools: Blender, anny, cache.
        fits: whether the meshes of the fits in `out` are rendered in place of those of the shots.
    """

    out: str
    tools: Tools
    fits: bool = False


def run_capture_stage(
    set_names: Sequence[str], context: CaptureStageContext, small: bool, cluster: ClusterSpec, listen: Listener
) -> Outcome:
    """Renders what is missing of some sets; a set that builds on another comes after it.

    Raises:
        UsageError: the cluster cannot be used.
        ClusterLostError: the scheduler vanished; finished pictures stay.
    """
    where = cluster.of_job(False, Path(context.out) / "run")
    check_cluster(where)
    graph = capture_stage_graph(set_names, small, Path(context.out) if context.fits else None)
    book = RecordBook(Path(context.out) / "records")
    _forget_damaged(book, graph, Path(context.out))
    driver = Driver(context, graph, book, render_node, DriverSettings(), listen)
    outcome = driver.reuse()
    listen({"event": "plan", "stages": {"render": len(graph)}, "reused": {"render": len(outcome.reused)}})
    with open_cluster(where) if driver.remaining else nullcontext() as client:
        if client is None:
            return outcome
        listen({"event": "cluster", "dashboard": dashboard_of(client), "scheduler": address_of(client)})
        return driver.run(client)


def render_node(context: CaptureStageContext, node: Node) -> dict[str, Any]:
    """Starts Blender once for one job. Running it again, or after a kill, leaves the same files."""
    began = time.perf_counter()
    assert isinstance(node.task, RenderTask)
    job = node.task.job
    receipt = render(job, Path(context.out), context.tools)
    files = {str(Path(receipt.folder) / name): digest for name, digest in receipt.files.items()}
    seconds = time.perf_counter() - began
    book = RecordBook(Path(context.out) / "records")
    book.commit(
        Record(node.stage.label, node.frames[0], node.key, node.fields, {}, files, {"task": seconds, "kernel": seconds})
    )
    return {"seconds": seconds, "kernel_seconds": seconds, "peak_bytes": peak_bytes(), "pid": 0}


def _forget_damaged(book: RecordBook, graph: Any, out: Path) -> None:
    """A record whose pictures are gone or changed is none: they are rendered again."""
    for node in graph:
        if book.find(node.stage, node.frames[0]) and find_receipt(node.task.job, out) is None:
            book.forget(node.stage, node.frames[0])
