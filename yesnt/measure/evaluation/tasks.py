"""The one function that workers call: the product's stages as ever, the evaluation's own beside them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from yesnt.core.shot import Job
from yesnt.core.threads import pin_threads
from yesnt.measure.evaluation.remains import bounces
from yesnt.measure.evaluation.scorer import judge, search
from yesnt.measure.evaluation.sequence_tasks import exact, film, material
from yesnt.planning.graph import Node
from yesnt.tasks.run import run_node
from yesnt.tasks.workspace import Workspace

TASKS: dict[str, Callable[[Workspace], None]] = {
    "exact": exact, "material": material, "search": search, "given": judge, "reference": judge, "judge": judge,
    "flat": judge, "film": film, "bounces": bounces, "steps": judge,
}  # fmt: skip
"""The evaluation's stages; `judge.MAP` is the stage `judge` of one map."""


def run_evaluation_node(job: Job, node: Node) -> dict[str, Any]:
    """Runs one node on a worker; doing it twice, or after a kill, gives the same records."""
    task = TASKS.get(node.stage.partition(".")[0])
    if task is None:
        return run_node(job, node)
    pin_threads()
    space = Workspace(job, node)
    with space.logged():
        if space.pending():
            task(space)
    return space.receipt()
