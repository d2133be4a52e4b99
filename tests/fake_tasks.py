"""Tasks that do what a test says: wait, fail, or kill their worker. Importable by workers."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from yesnt.core.shot import Job
from yesnt.io.records import Record, RecordBook
from yesnt.planning.graph import Node


def fake_task(job: Job, node: Node) -> dict[str, Any]:
    """Commits a record, unless `arguments` say otherwise; counts its runs in a file."""
    folder = Path(job.root)
    runs = folder / "runs" / f"{node.stage}.{node.index}"
    runs.parent.mkdir(exist_ok=True)
    with runs.open("a") as stream:
        stream.write("x")
    time.sleep(node.arguments.get("sleep", 0.01))
    if node.arguments.get("kill"):
        os.kill(os.getpid(), signal.SIGKILL)
    if len(runs.read_text()) <= node.arguments.get("fail", 0):
        raise RuntimeError("told to fail")
    book = RecordBook(folder / "records")
    for frame in node.frames:
        book.commit(Record(node.stage, frame, node.frame_key(frame), node.frame_fields(frame)))
    return {"seconds": 0.01, "kernel_seconds": 0.01, "peak_bytes": 0, "pid": os.getpid()}


def runs_of(job: Job, stage: str, index: int) -> int:
    """How often a node was started."""
    path = Path(job.root) / "runs" / f"{stage}.{index}"
    return len(path.read_text()) if path.exists() else 0
