"""Tasks that do what a test says: wait, fail, or kill their worker. Importable by workers."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io.records import Record, RecordBook
from yesnt.planning.graph import Node
from yesnt.planning.task_records import TaskRecord

A, B = StageId("a"), StageId("b")


@dataclass(frozen=True)
class FakeTask(TaskRecord):
    """How a task behaves: seconds that it sleeps, whether it kills its worker, how often it fails first."""

    sleep: float = 0.01
    kill: bool = False
    fail: int = 0


def fake_task(job: Job, node: Node) -> dict[str, Any]:
    """Commits a record, unless the task's record says otherwise; counts its runs in a file."""
    folder = Path(job.root)
    runs = folder / "runs" / f"{node.stage}.{node.index}"
    runs.parent.mkdir(exist_ok=True)
    with runs.open("a") as stream:
        stream.write("x")
    task = node.task if isinstance(node.task, FakeTask) else FakeTask()
    time.sleep(task.sleep)
    if task.kill:
        os.kill(os.getpid(), signal.SIGKILL)
    if len(runs.read_text()) <= task.fail:
        raise RuntimeError("told to fail")
    book = RecordBook(folder / "records")
    for frame in node.frames:
        book.commit(Record(node.stage.label, frame, node.frame_key(frame), node.frame_fields(frame)))
    return {"seconds": 0.01, "kernel_seconds": 0.01, "peak_bytes": 0, "pid": os.getpid()}


def runs_of(job: Job, stage: StageId | str, index: int) -> int:
    """How often a node was started."""
    path = Path(job.root) / "runs" / f"{stage}.{index}"
    return len(path.read_text()) if path.exists() else 0
