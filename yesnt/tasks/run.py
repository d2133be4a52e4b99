"""Runs one node on a worker: the function of its task record, as the stage table names it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from yesnt.core.shot import Job, Shot
from yesnt.core.threads import pin_threads
from yesnt.planning.graph import Node
from yesnt.planning.stages import function_of
from yesnt.tasks.shortages import shortage_of
from yesnt.tasks.workspace import Workspace


def run_node(job: Job, node: Node) -> dict[str, Any]:
    """Runs one node; twice, or after a kill, it leaves the same files.

    Returns:
        A receipt: seconds and peak memory (`Workspace.receipt`).

    Raises:
        ShortageError: the task cannot run now, because another process holds what it needs.
    """
    pin_threads()
    space: Workspace[Any] = Workspace(job, node)
    with space.claimed(), space.logged():
        if space.pending():
            module, _, name = function_of(node.stage, node.task).partition(":")
            try:
                getattr(import_module(module), name)(space)
            except Exception as error:
                if shortage := shortage_of(error):
                    raise shortage from error
                raise
    return space.receipt()


def worker_modules(shot: Shot) -> tuple[str, ...]:
    """What a worker imports before its first task; heavy parts that only some jobs need are imported where chosen."""
    always = (
        "yesnt.tasks.run",
        "yesnt.tasks.flow",
        "yesnt.tasks.relight",
        "yesnt.tasks.solve",
        "yesnt.temporal.flow",
        "yesnt.relight.frame",
        "OpenEXR",
        "trimesh",
    )
    return (
        always
        if not shot.decompose.samples_backend
        else (*always, "yesnt.decompose.ensemble", "yesnt.decompose.registry", "torch")
    )
