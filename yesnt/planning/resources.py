"""Which tasks need a worker with a GPU."""

from __future__ import annotations

from yesnt.core.shot import Shot
from yesnt.decompose.registry import ENTRIES
from yesnt.planning.graph import Node
from yesnt.planning.task_records import DecomposeTask, WindowTask


def needs_gpu(shot: Shot) -> bool:
    """Whether the job decomposes with a backend that is made for a GPU."""
    return shot.decompose.samples_backend and ENTRIES[shot.decompose.backend].gpu


def runs_on_gpu(node: Node) -> bool:
    """Whether a node's task calls the decomposition's network; all other tasks are the processor's."""
    return isinstance(node.task, DecomposeTask | WindowTask)
