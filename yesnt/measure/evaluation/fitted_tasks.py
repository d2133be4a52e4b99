"""Task that scores a shot whose geometry is fitted: nothing of the given plate, G-buffer and proxy is relit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.file_digests import file_digest
from yesnt.measure.evaluation.fitted_rows import BLENDER, FITTED_ROWS, STRIP_ROW
from yesnt.measure.evaluation.pictures import strip_name, write_strip
from yesnt.measure.evaluation.scene import PARTS, ExchangedScene, Scene, SceneKey, open_scene
from yesnt.measure.evaluation.subjects import TrueMaterial, read_straight
from yesnt.measure.evaluation.task_records import FittedReferenceTask, FittedScoreTask
from yesnt.metrics.score import SOLID, Truth, score_briefly
from yesnt.planning.stages import DECOMPOSE, EVIDENCE, SOLVE
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]


def score_fitted(space: Workspace[FittedScoreTask]) -> None:
    """Scores the rows of one frame under one map at the pixels of the given matte, and the fitted geometry itself.

    The fitted matte is part of the picture: what it leaves of the colour over black is scored.
    """
    task, frame = space.task, space.frame
    given = shot_inputs.read_plate(space.job, frame)
    truth = Truth.of(*task.subject.read_relit(task.map, frame), given.matte)
    scene, env = open_scene(SceneKey(task.geometry, frame, 1, task.fitted)), task.subject.env_path(task.map)
    other: Workspace[Any] = Workspace(task.fitted, space.node)
    true = task.subject.read_material(frame, given.matte)
    planes = {
        "fitted_true": true.planes,
        "fitted_model": other.read(DECOMPOSE, "observed", frame),
        "fitted_cameras": other.read(SOLVE, "material", frame),
    }
    with space.kernel():
        told = {"fitted_cameras": _base_views(other, frame)} if task.base_from_views else {}
        pictures = {
            name: scene.relit(FITTED_ROWS[name], own, env, base_views=told.get(name)) for name, own in planes.items()
        }
        rows = {name: _scores(picture, scene.matte, truth) for name, picture in pictures.items()}
        parts = _parts(space, scene, true, truth) if task.parts else {}
    facts = {"rows": rows, "separation": {}, "parts": parts}
    facts["geometry"] = geometry_errors(space.job, task.fitted, space.camera(), frame)
    space.commit(frame, {}, _strip(space, scene, pictures, truth) if task.strip else {}, facts)


def _base_views(fitted: Workspace[Any], frame: int) -> F32:
    """Base colour by the capture's cameras and its weight, [H, W, 4]."""
    return fitted.read(EVIDENCE, "base_views", frame).transpose(1, 2, 0)


def score_fitted_reference(space: Workspace[FittedReferenceTask]) -> None:
    """Scores Blender's picture of the fitted mesh of one frame under one map, with the picture's own coverage."""
    task, frame = space.task, space.frame
    truth = Truth.of(*task.subject.read_relit(task.map, frame), shot_inputs.read_matte(space.job, frame))
    with space.kernel():
        rows = {BLENDER: _scores(*read_straight(Path(task.picture)), truth=truth)}
    space.commit(frame, {}, facts={"rows": rows, "separation": {}})


def _scores(picture: F32, opacity: F32, truth: Truth) -> dict[str, float]:
    return {metric.name: metric.value for metric in score_briefly(picture, truth, opacity)}


def _parts(space: Workspace[FittedScoreTask], fitted: Scene, true: TrueMaterial, truth: Truth) -> dict[str, Any]:
    """Scores of the given inputs with true materials, and of the same with one part of the fitted geometry each."""
    row, env = FITTED_ROWS["fitted_true"], space.task.subject.env_path(space.task.map)
    given = Scene(space.job, space.frame)
    found = {"given": _scores(given.relit(row, true.planes, env), given.matte, truth)}
    for part in PARTS:
        scene = ExchangedScene(space.job, space.frame, given=given, other=fitted, part=part)
        found[part] = _scores(scene.relit(row, true.planes, env), scene.matte, truth)
    return found


def _strip(
    space: Workspace[FittedScoreTask], scene: Scene, pictures: Mapping[str, F32], truth: Truth
) -> dict[str, str]:
    """Plate, truth, ours, FLIP and ours with true materials side by side, each with its own coverage."""
    path = space.output.root / "pictures" / strip_name(space.task.map, space.frame, STRIP_ROW)
    write_strip(path, scene.plate.color, pictures[STRIP_ROW], pictures["fitted_true"], truth, scene.matte)
    return {str(path.relative_to(space.output.root)): file_digest(path)}


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
