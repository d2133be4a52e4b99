"""Removes what a finished run no longer needs."""

from __future__ import annotations

import shutil

from yesnt.io.output import OutputFolder
from yesnt.planning.graph import Graph
from yesnt.planning.stages import FORMER_ARRAYS, STAGES
from yesnt.runtime.driver.driver import Records, is_done


def sweep_transients(graph: Graph, records: Records, output: OutputFolder) -> None:
    """Removes transient results once all their users are done: earlier sweeps, windows, video segments."""
    kept = [node for node in graph if not node.transient]
    for name in {node.stage.name for node in graph if node.transient}:
        passing = {node.id for node in graph if node.transient and node.stage.name == name}
        served = [node for node in kept if not passing.isdisjoint(node.needs)]
        if all(is_done(records, node) for node in served):
            # Records first: no record without its frame.
            for folder in (output.records, output.store, output.segments):
                for transient in folder.glob(f"{name}.*"):
                    shutil.rmtree(transient)
    _sweep_former(output)
    shutil.rmtree(output.task_leases, ignore_errors=True)  # of workers that died after they had committed


def _sweep_former(output: OutputFolder) -> None:
    """Removes records and arrays that older versions kept under other names."""
    for name in (row.former_name for row in STAGES.values() if row.former_name):
        shutil.rmtree(output.records / name, ignore_errors=True)
    for name in FORMER_ARRAYS:
        shutil.rmtree(output.store / name, ignore_errors=True)
    (output.run / "driver.lock").unlink(missing_ok=True)
