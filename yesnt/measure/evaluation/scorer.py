"""Tasks that score one frame under one map, row by row, and the search for the best constant material."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.core.stage_id import StageId
from yesnt.io.file_digests import file_digest
from yesnt.measure.evaluation.nets import open_nets
from yesnt.measure.evaluation.pictures import strip_name, write_strip
from yesnt.measure.evaluation.rows import ROWS, SEPARATIONS, TRUE_SOLVES, Row
from yesnt.measure.evaluation.scene import SceneKey, open_scene
from yesnt.measure.evaluation.subjects import PROXY, TrueMaterial
from yesnt.measure.evaluation.task_records import ScoreTask, SearchTask
from yesnt.metrics.image import mean_squared_error, psnr
from yesnt.metrics.score import Truth, score, score_briefly
from yesnt.planning.stages import DECOMPOSE, SOLVE
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]

VIDEO_ROWS = ("unregularised", "full")
"""Rows whose pictures are kept to measure their videos."""

INDEPENDENT_KEPT = ("full_true",)
"""Rows without decomposition whose pictures are kept: the errors of single stages are measured against them."""

SEARCH_STRIDE = 5
SEARCH_ROUGHNESS = (0.2, 0.35, 0.5, 0.65, 0.8, 1.0)
SEARCH_METALLIC = (0.0, 0.25, 0.5, 1.0)


def score_rows(space: Workspace[ScoreTask]) -> None:
    """Scores the rows of one frame under one map; keeps the pictures that the video's metrics need."""
    task, frame = space.task, space.frame
    scorer = _RowScorer(space)
    rows = [ROWS[row] for row in task.rows]
    with space.kernel():
        pictures = {row.name: scorer.picture(row) for row in rows}
        facts: dict[str, Any] = {"rows": {row.name: scorer.scores(row, pictures[row.name]) for row in rows}}
        pictures |= scorer.independent()
        facts["separation"] = scorer.separations(pictures)
    files = _strip(space, scorer, pictures) if task.strip else {}
    kept = {f"relit.{row}": pictures[row].transpose(2, 0, 1) for row in task.keep}
    space.commit(frame, kept, files, facts)


def search(space: Workspace[SearchTask]) -> None:
    """PSNR of every candidate constant on one frame under one map, at one pixel in 25, with a coarse light."""
    task, frame = space.task, space.frame
    scene = open_scene(SceneKey(task.shot, frame, SEARCH_STRIDE, space.job))
    radiance, opacity = task.subject.read_relit(task.map, frame)
    inside = (np.minimum(scene.matte, opacity) > 0.99) & (scene.matte > 0)
    row = Row("", "", "separation", "constant", "", {**task.knobs})
    errors, env = {}, task.subject.env_path(task.map)
    with space.kernel():
        for roughness in SEARCH_ROUGHNESS:
            for metallic in SEARCH_METALLIC:
                relit = scene.relit(row, constant_planes((roughness, metallic), opacity.shape), env)
                errors[f"{roughness},{metallic}"] = psnr(srgb_encode(relit), srgb_encode(radiance), inside)
    space.commit(frame, {}, facts={"psnr": errors})


def constant_planes(pair: tuple[float, float], shape: tuple[int, ...]) -> F32:
    """[2, H, W] of one roughness and one metallic."""
    return np.broadcast_to(np.array(pair, np.float32)[:, None, None], (2, *shape))


class _RowScorer:
    """Scores one frame under one map; rows that are computed alike share one picture."""

    def __init__(self, space: Workspace[ScoreTask]) -> None:
        self._space, self._frame, self._task = space, space.frame, space.task
        self._subject, self._map = self._task.subject, self._task.map
        subject, name = self._subject, self._map
        self.scene = open_scene(SceneKey(self._task.shot, self._frame, 1, space.job))
        self.truth = Truth.of(*subject.read_relit(name, self._frame), self.scene.plate.matte, _nets(space))
        self._material: TrueMaterial = subject.read_material(self._frame, self.scene.plate.matte)
        self._made: dict[Any, F32] = {}

    def picture(self, row: Row) -> F32:
        """The relit picture [H, W, 3] of a row, straight, scene-linear."""
        way = (row.source, tuple(sorted(row.knobs.items())), row.proxy, row.true_base, self._constant(row))
        if way not in self._made:
            self._made[way] = self._make(row)
        return self._made[way]

    def independent(self) -> dict[str, F32]:
        """The pictures that the node of the independent rows has kept for this frame."""
        stage = StageId("independent", part=self._map)
        if self._space.node.stage.name != "score" or not self._task.thorough:
            return {}
        read = {row: self._space.read(stage, f"relit.{row}", self._frame) for row in INDEPENDENT_KEPT}
        return {row: picture.transpose(1, 2, 0) for row, picture in read.items()}

    def scores(self, row: Row, picture: F32) -> Mapping[str, float]:
        """Metrics of a row by name: all of them on scored frames of table rows, otherwise the quick ones."""
        if row.group == "separation":
            return {}
        full = row.thorough and self._task.thorough
        found = score(picture, self.truth) if full else score_briefly(picture, self.truth)
        return {metric.name: metric.value for metric in found}

    def separations(self, pictures: Mapping[str, F32]) -> dict[str, float]:
        """Mean squared display error of each stage on its own."""
        shown = {name: srgb_encode(picture) for name, picture in pictures.items()}
        shown["truth"] = srgb_encode(self.truth.radiance)
        return {
            one.stage: mean_squared_error(shown[one.candidate], shown[one.reference], self.truth.inside)
            for one in SEPARATIONS
            if one.candidate in shown and one.reference in shown
        }

    def _constant(self, row: Row) -> tuple[float, float] | None:
        pair = self._task.constants.get(row.name)
        return None if pair is None else (float(pair[0]), float(pair[1]))

    def _make(self, row: Row) -> F32:
        if row.source == "plate":
            return self.scene.plate.color
        if row.source == "blender":
            return self._subject.read_relit(self._map, self._frame, PROXY)[0]
        env = self._subject.env_path(self._map)
        return self.scene.relit(row, self._planes(row), env, self._material.base_color)

    def _planes(self, row: Row) -> F32:
        pair = self._constant(row)
        if pair is not None:
            return constant_planes(pair, self.truth.opacity.shape)
        if row.source == "true":
            return self._material.planes
        stage, array = _ARRAYS[row.source]
        return self._space.read(stage, array, self._frame)


_ARRAYS = {
    "own": (SOLVE, "material"),
    "observed": (DECOMPOSE, "observed"),
    **{source: (StageId("solve_true"), array) for source, array in TRUE_SOLVES.items()},
}
"""Stage and array that hold the material of each source."""


def _nets(space: Workspace[ScoreTask]) -> Any:
    return open_nets(space.task.lpips)


def _strip(space: Workspace[ScoreTask], scorer: _RowScorer, pictures: Mapping[str, F32]) -> dict[str, str]:
    """Plate, truth, ours, FLIP and ours with true materials side by side, for the page."""
    row = next(name for name in ("full", "full_true") if name in pictures)
    path = space.output.root / "pictures" / strip_name(space.task.map, space.frame, row)
    ceiling = pictures["full_true"] if row == "full" else None
    write_strip(path, scorer.scene.plate.color, pictures[row], ceiling, scorer.truth)
    return {str(path.relative_to(space.output.root)): file_digest(path)}
