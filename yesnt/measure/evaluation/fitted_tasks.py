"""Task that scores a shot whose geometry is fitted: nothing of the given plate, G-buffer and proxy is relit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.measure.evaluation.fitted_rows import FITTED_ROWS
from yesnt.measure.evaluation.scene import SceneKey, open_scene
from yesnt.measure.evaluation.task_records import FittedScoreTask
from yesnt.metrics.score import SOLID, Truth, score_briefly
from yesnt.planning.stages import DECOMPOSE, SOLVE
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]


def score_fitted(space: Workspace[FittedScoreTask]) -> None:
    """Scores the rows of one frame under one map at the pixels of the given matte, and the fitted geometry itself."""
    task, frame = space.task, space.frame
    given = shot_inputs.read_plate(space.job, frame)
    truth = Truth.of(*task.subject.read_relit(task.map, frame), given.matte)
    scene, env = open_scene(SceneKey(task.geometry, frame, 1, task.fitted)), task.subject.env_path(task.map)
    other: Workspace[Any] = Workspace(task.fitted, space.node)
    planes = {
        "fitted_true": task.subject.read_material(frame, given.matte).planes,
        "fitted_model": other.read(DECOMPOSE, "observed", frame),
        "fitted_cameras": other.read(SOLVE, "material", frame),
    }
    rows = {}
    with space.kernel():
        for name, materials in planes.items():
            found = score_briefly(scene.relit(FITTED_ROWS[name], materials, env), truth)
            rows[name] = {metric.name: metric.value for metric in found}
    geometry = geometry_errors(space.job, task.fitted, space.camera(), frame)
    space.commit(frame, {}, facts={"rows": rows, "separation": {}, "geometry": geometry})


def geometry_errors(given: Job, fitted: Job, camera: Camera, frame: int) -> dict[str, float]:
    """Medians over the pixels of the given matte: angle of normals, degrees; error and bias of z, mm; coverage's error.

    `matte` is the mean absolute error of the fitted matte over the pixels that either matte covers in part or wholly.
    """
    mattes = [shot_inputs.read_matte(job, frame) for job in (given, fitted)]
    true, own = (shot_inputs.read_surface(job, frame, camera) for job in (given, fitted))
    inside = (mattes[0] > SOLID) & (own.z > 0)
    cosine = (_unit(true.normal) * _unit(own.normal)).sum(axis=-1)[inside]
    depth = 1000 * (own.z - true.z)[inside]
    either = np.maximum(*mattes) > 0
    return {
        "normals": float(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1))))),
        "depth": float(np.median(np.abs(depth))),
        "bias": float(np.median(depth)),
        "matte": float(np.abs(mattes[1] - mattes[0])[either].mean()),
    }


def _unit(normals: F32) -> F32:
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
