"""Nodes that correct the observed materials; none for a job without corrections."""

from __future__ import annotations

from collections.abc import Iterator

from yesnt.io.jobfile import correction_patterns
from yesnt.io.records import SharedSettings
from yesnt.planning.builders.assemble import frame_node, node_fields, node_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import CORRECT
from yesnt.planning.task_records import CorrectTask


def correct_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Every decomposed frame with the job's corrections."""
    shot = plan.job.shot
    if not shot.corrected:
        return
    settings = _settings(plan)
    for frame in plan.present:
        estimated = graph.committer(plan.estimated, frame)
        inputs = plan.plate_inputs(frame) | plan.inputs(frame, **correction_patterns(shot))
        fields = node_fields(plan, CORRECT, settings, node_keys([estimated]), inputs=inputs)
        yield frame_node(plan, CORRECT, frame, fields, CorrectTask(), [estimated])


def _settings(plan: ShotPlan) -> SharedSettings:
    """What is done with the files: their digests are inputs."""
    shot = plan.job.shot
    return shared(
        **plan.plate_settings,
        quantities={name: changed_keys(one, {"path"}) for name, one in shot.decompose.quantities.items()},
        materials=[changed_keys(one, {"mask", "cryptomatte"}) for one in shot.materials],
    )
