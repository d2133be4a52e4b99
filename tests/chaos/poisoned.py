"""`yesnt` with tasks of one frame that always end their worker: `CHAOS_POISON=STAGE:FRAME:HOW`."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from yesnt.core.shot import Job
from yesnt.planning.graph import Node
from yesnt.tasks.run import run_node

HOW = ("kill", "segfault", "exit")


def poisoned_node(job: Job, node: Node) -> dict[str, Any]:
    """Runs a node, unless it is the poisonous one."""
    stage, frame, how = os.environ["CHAOS_POISON"].split(":")
    if node.stage.label == stage and int(frame) in node.frames:
        if how == "exit":
            sys.exit(1)
        os.kill(os.getpid(), {"kill": signal.SIGKILL, "segfault": signal.SIGSEGV}[how])
    return run_node(job, node)


if __name__ == "__main__":
    from tests.chaos import poisoned
    from yesnt import cli
    from yesnt.runtime import session

    session.run_node = poisoned.poisoned_node  # type: ignore[attr-defined]
    cli.main()
