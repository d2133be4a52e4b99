"""Task that measures the contribution of further bounces on one frame under one map."""

from __future__ import annotations

from dataclasses import replace

from yesnt.core.color import srgb_encode
from yesnt.measure.evaluation.rows import ROWS, Row
from yesnt.measure.evaluation.scene import SceneKey, open_scene
from yesnt.measure.evaluation.task_records import BouncesTask
from yesnt.metrics.image import mean_squared_error
from yesnt.metrics.score import Truth
from yesnt.tasks.workspace import Workspace


def bounces(space: Workspace[BouncesTask]) -> None:
    """Squared display errors against the full truth: of truths with few bounces, and of ours with as many bounces."""
    subject, name, frame = space.task.subject, space.task.map, space.frame
    scene = open_scene(SceneKey(space.task.shot, frame, 1, space.job))
    radiance, opacity = subject.read_relit(name, frame)
    truth = Truth.of(radiance, opacity, scene.plate.matte)
    material, whole = subject.read_material(frame, scene.plate.matte), srgb_encode(truth.radiance)
    facts = {}
    with space.kernel():
        for number in subject.early_paths(name, frame):
            early = subject.read_relit(name, frame, f"bounces{number}_")[0]
            row = _with_bounces(number)
            ours = scene.relit(row, material.planes, subject.env_path(name))
            facts[str(number)] = {
                "effect": mean_squared_error(srgb_encode(early), whole, truth.inside),
                "ours": mean_squared_error(srgb_encode(ours), whole, truth.inside),
                "ours_alike": mean_squared_error(srgb_encode(ours), srgb_encode(early), truth.inside),
            }
    space.commit(frame, {}, facts={"bounces": facts})


def _with_bounces(number: int) -> Row:
    return replace(ROWS["full_true"], knobs={"bounce": number})
