"""Nodes of the evaluation of one shot. Keys hold everything that a result depends on, so finished work is kept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from yesnt.capture_stage.reference import fitted_picture
from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io.file_digests import file_digest, file_identity
from yesnt.io.records import digest_of
from yesnt.measure.evaluation.evidence_rows import shown_row
from yesnt.measure.evaluation.nets import stlpips_weights
from yesnt.measure.evaluation.rows import ROWS, TRUE_SOLVES, Row
from yesnt.measure.evaluation.scorer import (
    INDEPENDENT_KEPT,
    SEARCH_METALLIC,
    SEARCH_ROUGHNESS,
    SEARCH_STRIDE,
    VIDEO_ROWS,
)
from yesnt.measure.evaluation.subjects import PROXY, RELIT, Subject, common_frames
from yesnt.measure.evaluation.task_records import (
    BouncesTask,
    FittedReferenceTask,
    FittedScoreTask,
    MaterialTask,
    MeasuredMaterialTask,
    MeasuredScoreTask,
    MeasuredVideoTask,
    ScoreTask,
    SearchTask,
    SubjectTask,
    TrueSolveTask,
    VideoTask,
)
from yesnt.planning import settings as of
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys
from yesnt.planning.stages import DECOMPOSE, FLOW, SOLVE, STAGES
from yesnt.runtime.session import Session

VERSION = 4
"""Version of the evaluation's tasks; raised when a number or the name of a stage changes, so that all is redone."""

Upstream = tuple[StageId, int]
"""Stage and frame that a node reads."""

SOLVE_TRUE, MATERIAL, MEASURED_MATERIAL = StageId("solve_true"), StageId("material"), StageId("measured_material")

SEARCH_KNOBS = {
    "texels": 256, "clusters": 32, "capture_texels": 128, "capture_clusters": 32, "bounce": 1, "capture_passes": 1,
}  # fmt: skip
"""Cheap relighting for the search of constants; with the bounce, for which constants would compensate otherwise."""


@dataclass(frozen=True)
class EvalPlan:
    """Builds the evaluation's nodes of one shot.

    Attributes:
        subject: the shot and its ground truth.
        session: the shot as a job whose output lies in the evaluation's folder.
        lacking: why there is no decomposition; "" if there is one.
        thorough: largest number of frames per shot on which every row is scored.
        probes: largest number of maps per shot for the term-by-term rows and the search of constants.
        chosen: frames on which every row is scored instead; empty: as `thorough` says.
        lpips: the user's LPIPS weights.
        measured: row -> the same shot as a job that measures its materials by a capture; none without a capture.
        fitted: the same shot as a job that has its capture alone; None if no field is to be fitted.
    """

    subject: Subject
    session: Session
    lacking: str = ""
    thorough: int = 3
    probes: int = 3
    chosen: tuple[int, ...] = ()
    lpips: Path | None = None
    measured: Mapping[str, Session] = field(default_factory=dict)
    fitted: Session | None = None

    @property
    def frames(self) -> tuple[int, ...]:
        """All frames of the shot."""
        return self.session.job.frames

    def scored_frames(self, name: str) -> tuple[int, ...]:
        """Frames on which every row is scored under a map: those chosen, or spread evenly over those with truth."""
        there = common_frames(self.subject, name, self.frames)
        if self.chosen:
            return tuple(frame for frame in there if frame in self.chosen)
        return tuple(there[i] for i in np.unique(np.linspace(0, len(there) - 1, self.thorough).round().astype(int)))

    @cached_property
    def probe_maps(self) -> tuple[str, ...]:
        """Maps for the term-by-term rows and the search of constants, spread evenly over those of the shot."""
        names = [name for name, _ in self.subject.maps]
        return tuple(names[i] for i in np.unique(np.linspace(0, len(names) - 1, self.probes).round().astype(int)))

    def has_video(self, name: str) -> bool:
        """Whether all frames have truth under a map, so that the video can be measured."""
        whole = common_frames(self.subject, name, self.frames) == self.frames
        return not self.lacking and len(self.frames) > 1 and whole

    @cached_property
    def true_solves(self) -> tuple[str, ...]:
        """Arrays of the possible solves of true materials: along true flow if known, along ours if computed."""
        true = len(self.frames) == 1 or self.subject.has_flow(self.frames)
        own = len(self.frames) > 1 and not self.lacking
        return tuple(array for array, can in zip(TRUE_SOLVES.values(), (true, own), strict=True) if can)

    def absent(self, name: str) -> dict[str, str]:
        """Rows that cannot be computed under a map, and why."""
        reasons = {row.name: self._reason(row, name) for row in ROWS.values()}
        return {row: reason for row, reason in reasons.items() if reason}

    def _reason(self, row: Row, name: str) -> str:
        if row.needs_own and self.lacking:
            return self.lacking
        if row.source == "blender":
            proxy = self.subject.relit_path(name, self.scored_frames(name)[0], PROXY)
            return "" if proxy.is_file() else f"the set holds no {proxy.name}: not rendered"
        array = TRUE_SOLVES.get(row.source)
        return "one frame has no flow" if array is not None and array not in self.true_solves else ""

    def arrays(self) -> dict[str, str]:
        """Arrays of the store that only the evaluation writes, and the channel whose shape each has."""
        names = [name for name, _ in self.subject.maps]
        videos = [name for name in names if self.has_video(name)]
        kept = [StageId("score", part=n).array(f"relit.{row}") for n in videos for row in VIDEO_ROWS]
        kept += [StageId("independent", part=n).array(f"relit.{row}") for n in names for row in INDEPENDENT_KEPT]
        return dict.fromkeys(kept, "diffuse") | dict.fromkeys(self.true_solves, "material")

    def solve_true(self, graph: Graph) -> Node:
        """Solves of the true materials."""
        upstream: list[Upstream] = []
        if not self.lacking:
            upstream += [(DECOMPOSE, frame) for frame in self.frames]
            upstream += [(FLOW, frame) for frame in self.frames[:-1]]
        shot = self.session.job.shot
        settings = {
            "energy": changed_fields(of.energy_params(shot)), "tolerance": shot.temporal.tolerance,
            "arrays": self.true_solves,
        }  # fmt: skip
        inputs = self._truth_files() | self._shot_files(self.frames)
        task = TrueSolveTask(self.subject, not self.lacking, self.true_solves)
        return self._node(SOLVE_TRUE, self.frames, settings, inputs, upstream, graph, task)

    def material(self, graph: Graph) -> Node:
        """Errors of materials and flow."""
        upstream = [(stage, frame) for stage in (DECOMPOSE, SOLVE) for frame in self.frames]
        upstream += [(FLOW, frame) for frame in self.frames[:-1]]
        inputs = self._truth_files() | self._shot_files(self.frames)
        return self._node(MATERIAL, self.frames[:1], {}, inputs, upstream, graph, MaterialTask(self.subject))

    def search(self, name: str, graph: Graph) -> Node:
        """PSNR of candidate constants on one frame."""
        frame = self.page_frame(name)
        grid = {"roughness": SEARCH_ROUGHNESS, "metallic": SEARCH_METALLIC, "stride": SEARCH_STRIDE, **SEARCH_KNOBS}
        inputs, settings = self._picture_files(name, frame), self._relighting() | {"grid": grid}
        task = SearchTask(self.subject, name, SEARCH_KNOBS, self._shot_digest(frame))
        return self._node(StageId("search", part=name), (frame,), settings, inputs, [], graph, task)

    def independent(self, name: str, frame: int, graph: Graph) -> Node:
        """Scores the rows that do not depend on the decomposition; keeps pictures for the errors of single stages."""
        rows = [row.name for row in self._present(name) if row.independent and row.source != "blender"]
        task = self._score(name, frame, rows, strip=frame == self.page_frame(name), keep=INDEPENDENT_KEPT)
        return self._pictures("independent", frame, task, [], graph)

    def reference(self, name: str, frame: int, graph: Graph) -> Node:
        """Scores the row that Blender rendered; a node of its own, because it is often rendered later."""
        task = self._score(name, frame, [row.name for row in self._present(name) if row.source == "blender"])
        return self._pictures("reference", frame, task, [], graph, PROXY)

    def early(self, name: str) -> dict[int, Path]:
        """Truths of a map whose light paths end after so many bounces."""
        return self.subject.early_paths(name, self.page_frame(name))

    def bounces(self, name: str, graph: Graph) -> Node:
        """Measures the contribution of further bounces."""
        frame = self.page_frame(name)
        inputs = self._picture_files(name, frame)
        inputs |= {f"bounces {number}": _digest(path) for number, path in self.early(name).items()}
        task = BouncesTask(self.subject, name, self._shot_digest(frame))
        return self._node(StageId("bounces", part=name), (frame,), self._relighting(), inputs, [], graph, task)

    def score(self, name: str, frame: int, graph: Graph) -> Node:
        """Scores the rows that depend on the decomposition; on other frames only those whose videos are measured."""
        thorough = frame in self.scored_frames(name)
        own = [row for row in self._present(name) if not row.independent and row.group != "ablation"]
        rows = [row.name for row in own if thorough or row.name in VIDEO_ROWS]
        upstream = [(StageId("independent", part=name), frame)] if thorough else []
        upstream += [(SOLVE_TRUE, frame)] if thorough and self.true_solves else []
        if not self.lacking:
            upstream += [(DECOMPOSE, frame), (SOLVE, frame)]
        strip = not self.lacking and frame == self.page_frame(name)
        keep = VIDEO_ROWS if self.has_video(name) else ()
        task = self._score(name, frame, rows, thorough=thorough, strip=strip, keep=keep)
        return self._pictures("score", frame, task, upstream, graph)

    def ablation(self, name: str, frame: int, graph: Graph) -> Node:
        """Scores the term-by-term rows with own materials; they cost most and run last."""
        rows = [row.name for row in self._present(name) if not row.independent and row.group == "ablation"]
        return self._pictures("ablation", frame, self._score(name, frame, rows), [(SOLVE, frame)], graph)

    def _present(self, name: str) -> list[Row]:
        """Rows that can be computed under a map, except constants, which are known later."""
        absent, later = self.absent(name), ("constant", "own_constant")
        rows = [row for row in ROWS.values() if row.name not in absent and row.source not in later]
        return [row for row in rows if row.group != "ablation" or name in self.probe_maps]

    def page_frame(self, name: str) -> int:
        """The frame whose pictures the page shows."""
        scored = self.scored_frames(name)
        return scored[len(scored) // 2]

    def _score(self, name: str, frame: int, rows: Sequence[str], **more: Any) -> ScoreTask:
        return ScoreTask(self.subject, name, self._shot_digest(frame), tuple(rows), lpips=self.lpips, **more)

    def constant_rows(self, name: str, frame: int, constants: Mapping[str, tuple[float, float]]) -> Node:
        """Scores the rows of constant materials."""
        task = self._score(name, frame, list(constants), constants=dict(constants))
        return self._pictures("constant", frame, task, [], Graph())

    def measured_score(self, name: str, frame: int) -> Node:
        """Scores the rows whose materials a capture measured."""
        views, strip = self._base_from_views, shown_row(self.measured) if frame == self.page_frame(name) else ""
        task = MeasuredScoreTask(self.subject, name, self._shot_digest(frame), self._measured_jobs, views, strip)
        settings = self._relighting() | {"materials": self._measured_keys((frame,))}
        settings |= {"base_from_views": views, "strip": strip}
        inputs = self._picture_files(name, frame)
        return self._node(StageId("measured", part=name), (frame,), settings, inputs, [], Graph(), task)

    def measured_material(self) -> Node:
        """Errors of materials that a capture measured."""
        task = MeasuredMaterialTask(self.subject, self._measured_jobs)
        settings = {"materials": self._measured_keys(self.frames)}
        inputs = self._truth_files() | self._shot_files(self.frames)
        return self._node(MEASURED_MATERIAL, self.frames[:1], settings, inputs, [], Graph(), task)

    def measured_video(self, name: str) -> Node:
        """Measures the video of the row of most cameras."""
        row = shown_row(self.measured)
        views, keys = row in self._base_from_views, self._measured_keys(self.frames)
        shots = {frame: self._shot_digest(frame) for frame in self.frames}
        task = MeasuredVideoTask(self.subject, name, row, shots, self.measured[row].job, views)
        settings = self._relighting() | {"materials": keys[row], "base_from_views": views, "nets": self._nets()}
        inputs = self._truth_files() | self._shot_files(self.frames) | {"env": _digest(self.subject.env_path(name))}
        inputs |= {f"relit {frame}": _digest(self.subject.relit_path(name, frame)) for frame in self.frames}
        stage = StageId("measured_video", part=name)
        return self._node(stage, self.frames[:1], settings, inputs, [], Graph(), task)

    def fitted_score(self, name: str, frame: int) -> Node:
        """Scores the rows whose geometry is fitted."""
        assert self.fitted is not None
        graph = self.fitted.graph()
        made = {stage.name: graph.committer(stage, frame).frame_key(frame) for stage in (DECOMPOSE, SOLVE)}
        geometry = digest_of({"views": dict(self.fitted.resolved.digests), **self._relighting()})
        extent = (name in self.probe_maps, frame == self.page_frame(name), self.fitted.plan().base_from_views)
        task = FittedScoreTask(self.subject, name, geometry, self.fitted.job, *extent)
        settings = self._relighting() | {"materials": made, "geometry": geometry, "extent": extent}
        inputs = self._picture_files(name, frame)
        return self._node(StageId("fitted", part=name), (frame,), settings, inputs, [], Graph(), task)

    @cached_property
    def _base_from_views(self) -> tuple[str, ...]:
        """Rows whose base colour the capture's cameras tell too."""
        return tuple(row for row, session in self.measured.items() if session.plan().base_from_views)

    def fitted_reference(self, name: str, frame: int) -> Node | None:
        """Scores the fitted mesh as Blender relights it; None where there is no picture of this very fit."""
        assert self.fitted is not None
        picture = fitted_picture(Path(self.fitted.job.root), name, frame)
        if picture is None:
            return None
        task = FittedReferenceTask(self.subject, name, str(picture))
        inputs = self._picture_files(name, frame) | {"blender proxy": _digest(picture)}
        return self._node(StageId("fitted_reference", part=name), (frame,), {}, inputs, [], Graph(), task)

    @property
    def _measured_jobs(self) -> dict[str, Job]:
        return {row: session.job for row, session in self.measured.items()}

    def _measured_keys(self, frames: Sequence[int]) -> dict[str, str]:
        """Keys of the solved materials of every row."""
        graphs = {row: session.graph() for row, session in self.measured.items()}
        keys = {row: [graph.committer(SOLVE, f).frame_key(f) for f in frames] for row, graph in graphs.items()}
        return {row: digest_of(list(found)) for row, found in keys.items()}

    def video(self, name: str, graph: Graph) -> Node:
        """Measures the videos of a map."""
        upstream = [(StageId("score", part=name), frame) for frame in self.frames]
        inputs = self._truth_files() | self._shot_files(self.frames)
        for frame in self.frames:
            inputs[f"relit {frame}"] = _digest(self.subject.relit_path(name, frame))
        stage, settings = StageId("video", part=name), {"nets": self._nets()}
        return self._node(stage, self.frames[:1], settings, inputs, upstream, graph, VideoTask(self.subject, name))

    def _pictures(
        self, stage: str, frame: int, task: ScoreTask, upstream: list[Upstream], graph: Graph, scored: str = RELIT
    ) -> Node:
        settings = self._relighting() | {"task": task.settings, "nets": self._nets()}
        inputs = self._picture_files(task.map, frame)
        if scored == PROXY:
            inputs["blender proxy"] = _digest(self.subject.relit_path(task.map, frame, PROXY))
        return self._node(StageId(stage, part=task.map), (frame,), settings, inputs, upstream, graph, task)

    def _nets(self) -> dict[str, str]:
        weights = stlpips_weights()
        known = {"stlpips": weights, "lpips": self.lpips}
        return {name: _digest(path) for name, path in known.items() if path is not None}

    def _relighting(self) -> dict[str, Any]:
        shot = self.session.job.shot
        capture = changed_keys(shot.capture_light) if shot.capture_light else None
        return {"relight": changed_fields(of.relight_settings(shot)), "capture": capture}

    def _picture_files(self, name: str, frame: int) -> dict[str, str]:
        truth = {
            "env": self.subject.env_path(name), "relit": self.subject.relit_path(name, frame),
            "material": self.subject.material_path(frame),
        }  # fmt: skip
        return self._shot_files((frame,)) | {role: _digest(path) for role, path in truth.items()}

    def _shot_digest(self, frame: int) -> str:
        """Key of a frame's inputs in the workers' cache."""
        return digest_of({"root": self.session.job.root, "files": self._shot_files((frame,)), **self._relighting()})

    def _truth_files(self) -> dict[str, str]:
        paths = [self.subject.material_path(frame) for frame in self.frames]
        if self.subject.has_flow(self.frames):
            paths += [self.subject.flow_path(frame) for frame in self.frames[:-1]]
        return {path.name: _digest(path) for path in paths}

    def _shot_files(self, frames: Iterable[int]) -> dict[str, str]:
        """Digests of the shot's own files: plates, G-buffers and proxies of these frames, camera, capture light."""
        from yesnt.io.jobfile import frame_path

        job = self.session.job
        shot, found = job.shot, {}
        patterns = [shot.plate.path, shot.gbuffer.path, shot.camera]
        patterns += [
            part.path
            for part in (shot.matte, shot.proxy, shot.capture_light)
            if part is not None and part.path is not None
        ]
        probes = job.probe_frames if shot.capture_light is not None and shot.capture_light.estimate else ()
        for frame in dict.fromkeys((*frames, *probes)):
            for pattern in patterns:
                path = str(frame_path(job.root, pattern, frame))
                found[Path(path).name] = self.session.resolved.digests[path]
        return found

    def _node(
        self,
        stage: StageId,
        frames: tuple[int, ...],
        settings: Mapping[str, Any],
        inputs: Mapping[str, str],
        upstream: list[Upstream],
        graph: Graph,
        task: SubjectTask,
    ) -> Node:
        # Tasks call these stages' kernels themselves, so their versions are part of the key.
        kernels = {name: STAGES[name].version for name in ("solve", "relight")}
        needs = [graph.committer(*need) for need in upstream]
        keys = (node.frame_key(frame) for (_, frame), node in zip(upstream, needs, strict=True))
        fields = {
            "stage": stage.label, "evaluation": VERSION, "kernels": kernels,
            "settings": dict(settings), "inputs": dict(inputs),
            "upstream": {f"{taken} {frame}": key for (taken, frame), key in zip(upstream, keys, strict=True)},
        }  # fmt: skip
        index = self.session.job.position(frames[0])
        return Node(stage, index, frames, fields, tuple(dict.fromkeys(node.id for node in needs)), task)


def _digest(path: Path) -> str:
    return _digest_of(path, file_identity(path))


@lru_cache(maxsize=100_000)
def _digest_of(path: Path, identity: tuple[int, ...]) -> str:
    """Digest of a file with this size and time; another file under the same path is read again."""
    del identity
    return file_digest(path)
