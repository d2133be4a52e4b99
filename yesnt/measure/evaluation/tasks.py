"""The one function that workers call: the evaluation's own tasks, and those of the product's stages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from yesnt.core.shot import Job
from yesnt.core.threads import pin_threads
from yesnt.measure.evaluation import task_records as records
from yesnt.measure.evaluation.bounce_task import bounces
from yesnt.measure.evaluation.fitted_tasks import score_fitted, score_fitted_reference
from yesnt.measure.evaluation.measured_tasks import measured_material, measured_video, score_measured
from yesnt.measure.evaluation.scorer import score_rows, search
from yesnt.measure.evaluation.sequence_tasks import material, solve_true, video
from yesnt.planning.graph import Node
from yesnt.planning.task_records import TaskRecord
from yesnt.tasks.run import run_node
from yesnt.tasks.workspace import Workspace

TASKS: dict[type[TaskRecord], Callable[[Workspace[Any]], None]] = {
    records.TrueSolveTask: solve_true,
    records.MaterialTask: material,
    records.SearchTask: search,
    records.ScoreTask: score_rows,
    records.BouncesTask: bounces,
    records.MeasuredMaterialTask: measured_material,
    records.MeasuredScoreTask: score_measured,
    records.MeasuredVideoTask: measured_video,
    records.FittedScoreTask: score_fitted,
    records.FittedReferenceTask: score_fitted_reference,
    records.VideoTask: video,
}
"""The function that runs each kind of task of the evaluation."""


def run_evaluation_node(job: Job, node: Node) -> dict[str, Any]:
    """Runs one node on a worker; doing it twice, or after a kill, gives the same records."""
    task = TASKS.get(type(node.task))
    if task is None:
        return run_node(job, node)
    pin_threads()
    space: Workspace[Any] = Workspace(job, node)
    with space.logged():
        if space.pending():
            task(space)
    return space.receipt()
