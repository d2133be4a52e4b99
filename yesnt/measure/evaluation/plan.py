"""Nodes of the evaluation of one shot: keys hold what each number depends on, so that a second run does nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from yesnt.core.stage_id import StageId
from yesnt.io.file_digests import file_digest
from yesnt.io.records import digest_of
from yesnt.measure.evaluation.nets import stlpips_weights
from yesnt.measure.evaluation.rows import EXACT_ARRAYS, ROWS, Row
from yesnt.measure.evaluation.scorer import FILMED, GIVEN_KEPT, SEARCH_METALLIC, SEARCH_ROUGHNESS, SEARCH_STRIDE
from yesnt.measure.evaluation.subjects import PROXY, RELIT, Subject, common_frames
from yesnt.measure.evaluation.task_records import (
    BouncesTask,
    ExactTask,
    MaterialTask,
    ScoreTask,
    SearchTask,
    SubjectTask,
    VideoTask,
)
from yesnt.planning import settings as of
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import changed_fields, changed_keys
from yesnt.planning.stages import DECOMPOSE, FLOW, SOLVE, STAGES
from yesnt.runtime.session import Session

VERSION = 3
"""Of this package's tasks; raised when a number changes, which makes every older record stale."""

Upstream = tuple[StageId, int]
"""Stage and frame of what a node takes."""

EXACT, MATERIAL = StageId("exact"), StageId("material")

SEARCH_KNOBS = {
    "texels": 256, "clusters": 32, "capture_texels": 128, "capture_clusters": 32, "bounce": 1, "capture_passes": 1,
}  # fmt: skip
"""Cheap relighting for the search of constants; the bounce stays, or constants would make up for it."""


@dataclass(frozen=True)
class EvalPlan:
    """Builds the evaluation's nodes of one shot.

    Attributes:
        subject: the shot and its truth.
        session: the product's own view of it, its output inside the evaluation's folder.
        lacking: why there is no decomposition; "" if there is.
        thorough: frames of a shot, at most, on which every row is scored.
        probes: maps of a shot, at most, under which the ladder is climbed and the best constants are searched.
        lpips: the user's LPIPS weights.
    """

    subject: Subject
    session: Session
    lacking: str = ""
    thorough: int = 3
    probes: int = 3
    lpips: Path | None = None

    @property
    def frames(self) -> tuple[int, ...]:
        """All frames of the shot."""
        return self.session.job.frames

    def judged(self, name: str) -> tuple[int, ...]:
        """Frames on which every row is scored under a map: spread over those that have truth."""
        there = common_frames(self.subject, name, self.frames)
        return tuple(there[i] for i in np.unique(np.linspace(0, len(there) - 1, self.thorough).round().astype(int)))

    @cached_property
    def probed(self) -> tuple[str, ...]:
        """Maps under which the ladder is climbed and constants are searched: spread over those of the shot."""
        names = [name for name, _ in self.subject.maps]
        return tuple(names[i] for i in np.unique(np.linspace(0, len(names) - 1, self.probes).round().astype(int)))

    def filmed(self, name: str) -> bool:
        """Whether there is a film under a map to be measured."""
        whole = common_frames(self.subject, name, self.frames) == self.frames
        return not self.lacking and len(self.frames) > 1 and whole

    @cached_property
    def exact_arrays(self) -> tuple[str, ...]:
        """Solves of true materials that can be made: along true flow if there is any, along ours if it is computed."""
        true = len(self.frames) == 1 or self.subject.has_flow(self.frames)
        own = len(self.frames) > 1 and not self.lacking
        return tuple(array for array, can in zip(EXACT_ARRAYS.values(), (true, own), strict=True) if can)

    def absent(self, name: str) -> dict[str, str]:
        """Rows that cannot be had under a map, and why."""
        reasons = {row.name: self._reason(row, name) for row in ROWS.values()}
        return {row: reason for row, reason in reasons.items() if reason}

    def _reason(self, row: Row, name: str) -> str:
        if row.needs_own and self.lacking:
            return self.lacking
        if row.source == "blender" and not self.subject.relit_path(name, self.judged(name)[0], PROXY).is_file():
            return f"the set holds no {self.subject.relit_path(name, self.judged(name)[0], PROXY).name}: not rendered"
        array = EXACT_ARRAYS.get(row.source)
        return "one frame has no flow" if array is not None and array not in self.exact_arrays else ""

    def arrays(self) -> dict[str, str]:
        """Arrays of the store beside the product's, and the channel that each is shaped like."""
        names = [name for name, _ in self.subject.maps]
        kept = [StageId("judge", part=n).array(f"relit.{row}") for n in names if self.filmed(n) for row in FILMED]
        kept += [StageId("given", part=n).array(f"relit.{row}") for n in names for row in GIVEN_KEPT]
        return dict.fromkeys(kept, "diffuse") | dict.fromkeys(self.exact_arrays, "material")

    def exact(self, graph: Graph) -> Node:
        """Solves of the true materials."""
        upstream: list[Upstream] = []
        if not self.lacking:
            upstream += [(DECOMPOSE, frame) for frame in self.frames]
            upstream += [(FLOW, frame) for frame in self.frames[:-1]]
        shot = self.session.job.shot
        settings = {
            "energy": changed_fields(of.energy_params(shot)), "tolerance": shot.temporal.tolerance,
            "arrays": self.exact_arrays,
        }  # fmt: skip
        inputs = self._truth_files() | self._shot_files(self.frames)
        task = ExactTask(self.subject, not self.lacking, self.exact_arrays)
        return self._node(EXACT, self.frames, settings, inputs, upstream, graph, task)

    def material(self, graph: Graph) -> Node:
        """Errors of materials and flow."""
        upstream = [(stage, frame) for stage in (DECOMPOSE, SOLVE) for frame in self.frames]
        upstream += [(FLOW, frame) for frame in self.frames[:-1]]
        inputs = self._truth_files() | self._shot_files(self.frames)
        return self._node(MATERIAL, self.frames[:1], {}, inputs, upstream, graph, MaterialTask(self.subject))

    def search(self, name: str, graph: Graph) -> Node:
        """PSNR of candidate constants on one frame."""
        frame = self.shown(name)
        grid = {"roughness": SEARCH_ROUGHNESS, "metallic": SEARCH_METALLIC, "stride": SEARCH_STRIDE, **SEARCH_KNOBS}
        inputs, settings = self._picture_files(name, frame), self._relighting() | {"grid": grid}
        task = SearchTask(self.subject, name, SEARCH_KNOBS, self._shot_digest(frame))
        return self._node(StageId("search", part=name), (frame,), settings, inputs, [], graph, task)

    def given(self, name: str, frame: int, graph: Graph) -> Node:
        """The rows that the decomposition has no part in; true materials are kept for the stages' own errors."""
        rows = [row.name for row in self._present(name) if row.given and row.source != "blender"]
        task = self._score(name, frame, rows, strip=frame == self.shown(name), keep=GIVEN_KEPT)
        return self._pictures("given", frame, task, [], graph)

    def reference(self, name: str, frame: int, graph: Graph) -> Node:
        """Blender's own row, apart from the others since it is rendered last."""
        task = self._score(name, frame, [row.name for row in self._present(name) if row.source == "blender"])
        return self._pictures("reference", frame, task, [], graph, PROXY)

    def early(self, name: str) -> dict[int, Path]:
        """Truths of a map whose light paths end after so many bounces."""
        return self.subject.early_paths(name, self.shown(name))

    def bounces(self, name: str, graph: Graph) -> Node:
        """What each further bounce is worth."""
        frame = self.shown(name)
        inputs = self._picture_files(name, frame)
        inputs |= {f"bounces {number}": _digest(path) for number, path in self.early(name).items()}
        task = BouncesTask(self.subject, name, self._shot_digest(frame))
        return self._node(StageId("bounces", part=name), (frame,), self._relighting(), inputs, [], graph, task)

    def judge(self, name: str, frame: int, graph: Graph) -> Node:
        """The rows that the decomposition has a part in, or on frames between only those of the film."""
        thorough = frame in self.judged(name)
        own = [row for row in self._present(name) if not row.given and row.group != "ladder"]
        rows = [row.name for row in own if thorough or row.name in FILMED]
        upstream = [(StageId("given", part=name), frame)] if thorough else []
        upstream += [(EXACT, frame)] if thorough and self.exact_arrays else []
        if not self.lacking:
            upstream += [(DECOMPOSE, frame), (SOLVE, frame)]
        strip = not self.lacking and frame == self.shown(name)
        keep = FILMED if self.filmed(name) else ()
        task = self._score(name, frame, rows, thorough=thorough, strip=strip, keep=keep)
        return self._pictures("judge", frame, task, upstream, graph)

    def steps(self, name: str, frame: int, graph: Graph) -> Node:
        """The ladder with own materials, which costs more than all else and is wanted last."""
        rows = [row.name for row in self._present(name) if not row.given and row.group == "ladder"]
        return self._pictures("steps", frame, self._score(name, frame, rows), [(SOLVE, frame)], graph)

    def _present(self, name: str) -> list[Row]:
        """Rows that can be had under a map, but for the constants, which are known later."""
        absent, later = self.absent(name), ("constant", "own_constant")
        rows = [row for row in ROWS.values() if row.name not in absent and row.source not in later]
        return [row for row in rows if row.group != "ladder" or name in self.probed]

    def shown(self, name: str) -> int:
        """The frame whose pictures stand on the page."""
        judged = self.judged(name)
        return judged[len(judged) // 2]

    def _score(self, name: str, frame: int, rows: Sequence[str], **more: Any) -> ScoreTask:
        return ScoreTask(self.subject, name, self._shot_digest(frame), tuple(rows), lpips=self.lpips, **more)

    def flat(self, name: str, frame: int, constants: Mapping[str, tuple[float, float]]) -> Node:
        """The rows of constant materials."""
        task = self._score(name, frame, list(constants), constants=dict(constants))
        return self._pictures("flat", frame, task, [], Graph())

    def film(self, name: str, graph: Graph) -> Node:
        """Numbers of the films of a map."""
        upstream = [(StageId("judge", part=name), frame) for frame in self.frames]
        inputs = self._truth_files() | self._shot_files(self.frames)
        for frame in self.frames:
            inputs[f"relit {frame}"] = _digest(self.subject.relit_path(name, frame))
        stage, settings = StageId("film", part=name), {"nets": self._nets()}
        return self._node(stage, self.frames[:1], settings, inputs, upstream, graph, VideoTask(self.subject, name))

    def _pictures(
        self, stage: str, frame: int, task: ScoreTask, upstream: list[Upstream], graph: Graph, judged: str = RELIT
    ) -> Node:
        settings = self._relighting() | {"task": task.settings, "nets": self._nets()}
        inputs = self._picture_files(task.map, frame)
        if judged == PROXY:
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
        """What the scene of a frame is remembered by in a worker."""
        return digest_of({"root": self.session.job.root, "files": self._shot_files((frame,)), **self._relighting()})

    def _truth_files(self) -> dict[str, str]:
        paths = [self.subject.material_path(frame) for frame in self.frames]
        if self.subject.has_flow(self.frames):
            paths += [self.subject.flow_path(frame) for frame in self.frames[:-1]]
        return {path.name: _digest(path) for path in paths}

    def _shot_files(self, frames: Iterable[int]) -> dict[str, str]:
        """What the shot itself brings: plates, G-buffers, proxies of these frames, camera, capture light."""
        from yesnt.io.jobfile import frame_path

        job = self.session.job
        shot, found = job.shot, {}
        patterns = [shot.plate.path, shot.gbuffer.path, shot.camera]
        patterns += [
            part.path for part in (shot.proxy, shot.capture_light) if part is not None and part.path is not None
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


@lru_cache(maxsize=100_000)
def _digest(path: Path) -> str:
    return file_digest(path)
