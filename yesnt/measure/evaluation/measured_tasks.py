"""Tasks that score materials which a capture measured; each row's materials lie in the output of a job of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io import shot_inputs
from yesnt.io.file_digests import file_digest
from yesnt.measure.evaluation.evidence_rows import EVIDENCE_ROWS
from yesnt.measure.evaluation.pictures import strip_name, write_strip
from yesnt.measure.evaluation.scene import Scene, SceneKey, open_scene
from yesnt.measure.evaluation.sequence_tasks import video_numbers
from yesnt.measure.evaluation.task_records import MeasuredMaterialTask, MeasuredScoreTask, MeasuredVideoTask
from yesnt.metrics.material import measure_material
from yesnt.metrics.score import SOLID, Truth, score_briefly
from yesnt.planning.stages import EVIDENCE, SOLVE
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]

PLANES = ("roughness", "metallic")


def score_measured(space: Workspace[MeasuredScoreTask]) -> None:
    """Scores every row on one frame under one map; relighting gets the true inputs."""
    task, frame = space.task, space.frame
    scene = open_scene(SceneKey(task.shot, frame, 1, space.job))
    truth = Truth.of(*task.subject.read_relit(task.map, frame), scene.plate.matte)
    env, rows, files = task.subject.env_path(task.map), {}, {}
    with space.kernel():
        for name, job in task.jobs.items():
            other: Workspace[Any] = Workspace(job, space.node)
            picture = _relit(scene, name, other, env, name in task.base_from_views)
            rows[name] = {metric.name: metric.value for metric in score_briefly(picture, truth)}
            if name == task.strip:
                path = space.output.root / "pictures" / strip_name(task.map, frame, name)
                write_strip(path, scene.plate.color, picture, None, truth)
                files[str(path.relative_to(space.output.root))] = file_digest(path)
    space.commit(frame, {}, files, {"rows": rows, "separation": {}})


def measured_video(space: Workspace[MeasuredVideoTask]) -> None:
    """Relights every frame of a row under one map and measures the video; relighting gets the true inputs."""
    task, env = space.task, space.task.subject.env_path(space.task.map)
    other: Workspace[Any] = Workspace(task.measured, space.node)

    def pictures() -> Iterator[F32]:
        for frame in space.job.frames:
            scene = open_scene(SceneKey(task.shots[frame], frame, 1, space.job))
            yield _relit(scene, task.row, other, env, task.base_from_views)

    with space.kernel():
        numbers = video_numbers(space, {task.row: pictures()})
    space.commit(space.frame, {}, facts={"video": numbers})


def _relit(scene: Scene, row: str, measured: Workspace[Any], env: Path, base_from_views: bool) -> F32:
    """Straight radiance [H, W, 3] of a row, with the base colour that the product would take."""
    planes = measured.read(SOLVE, "material", scene.frame)
    views = measured.read(EVIDENCE, "base_views", scene.frame).transpose(1, 2, 0) if base_from_views else None
    return scene.relit(EVIDENCE_ROWS[row], planes, env, base_views=views)


def measured_material(space: Workspace[MeasuredMaterialTask]) -> None:
    """Errors of every row's materials over all frames; calibration of the posterior's spread before the solve."""
    job, task = space.job, space.task
    mattes = {frame: shot_inputs.read_matte(job, frame) for frame in job.frames}
    inside = {frame: matte > SOLID for frame, matte in mattes.items()}
    true = [task.subject.read_material(frame, mattes[frame]).planes[:, inside[frame]] for frame in job.frames]
    facts: dict[str, Any] = {}
    for name, one in task.jobs.items():
        columns = {array: _column(one, space, (stage, array), inside) for stage, array in _READ}
        facts[name] = {}
        for i, plane in enumerate(PLANES):
            value = np.concatenate([planes[i] for planes in true])
            own, mean, spread = (columns[array][i] for _, array in _READ)
            numbers = measure_material(own, value, None, plane == "metallic")
            numbers += [m for m in measure_material(mean, value, spread) if m.name in ("spearman", "ause")]
            facts[name][plane] = {m.name: m.value for m in numbers if np.isfinite(m.value)}
    space.commit(space.frame, {}, facts={"measured": facts})


_READ = ((SOLVE, "material"), (EVIDENCE, "measured"), (EVIDENCE, "measured_spread"))


def _column(job: Job, space: Workspace[Any], at: tuple[StageId, str], inside: dict[int, NDArray[np.bool_]]) -> F32:
    """Values [2, n] of an array in another job's output over all frames' pixels."""
    other: Workspace[Any] = Workspace(job, space.node)
    return np.concatenate([other.read(*at, frame)[:, mask] for frame, mask in inside.items()], axis=1)
