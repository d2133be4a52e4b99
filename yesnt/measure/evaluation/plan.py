"""Nodes of the evaluation of one shot: keys hold what each number depends on, so that a second run does nothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from yesnt.io.records import key_of
from yesnt.io.shot_inputs import file_digest
from yesnt.measure.evaluation.nets import stlpips_weights
from yesnt.measure.evaluation.rows import EXACT_ARRAYS, ROWS, Row
from yesnt.measure.evaluation.scorer import FILMED, GIVEN_KEPT, SEARCH_METALLIC, SEARCH_ROUGHNESS, SEARCH_STRIDE
from yesnt.measure.evaluation.subjects import PROXY, RELIT, Subject, common_frames
from yesnt.planning import settings as of
from yesnt.planning.graph import Node, NodeId
from yesnt.planning.stages import STAGES
from yesnt.runtime.session import Session

VERSION = 3
"""Of this package's tasks; raised when a number changes, which makes every older record stale."""

Keys = Mapping[tuple[str, int], str]
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
        kept = {
            f"relit.{name}.{row}": "diffuse" for name, _ in self.subject.maps for row in FILMED if self.filmed(name)
        }
        kept |= {f"relit.{name}.{row}": "diffuse" for name, _ in self.subject.maps for row in GIVEN_KEPT}
        return kept | dict.fromkeys(self.exact_arrays, "material")

    def exact(self, keys: Keys) -> Node:
        """Solves of the true materials."""
        upstream: list[tuple[str, int]] = []
        if not self.lacking:
            upstream += [("decompose", frame) for frame in self.frames]
            upstream += [("flow", frame) for frame in self.frames[:-1]]
        shot = self.session.job.shot
        settings = {
            "energy": dataclasses.asdict(of.energy_params(shot)), "tolerance": shot.temporal.tolerance,
            "arrays": self.exact_arrays,
        }  # fmt: skip
        inputs = self._truth_files() | self._shot_files(self.frames)
        arguments = {"own": not self.lacking, "arrays": self.exact_arrays}
        return self._node("exact", self.frames, settings, inputs, upstream, keys, arguments)

    def material(self, keys: Keys) -> Node:
        """Errors of materials and flow."""
        upstream = [(stage, frame) for stage in ("decompose", "solve") for frame in self.frames]
        upstream += [("flow", frame) for frame in self.frames[:-1]]
        inputs = self._truth_files() | self._shot_files(self.frames)
        return self._node("material", self.frames[:1], {}, inputs, upstream, keys, {})

    def search(self, name: str) -> Node:
        """PSNR of candidate constants on one frame."""
        frame = self.shown(name)
        grid = {"roughness": SEARCH_ROUGHNESS, "metallic": SEARCH_METALLIC, "stride": SEARCH_STRIDE, **SEARCH_KNOBS}
        inputs = self._picture_files(name, frame)
        arguments = {
            "map": name, "env": self.subject.env_path(name), "knobs": SEARCH_KNOBS, "shot": self._shot_digest(frame),
        }  # fmt: skip
        return self._node(f"search.{name}", (frame,), self._relighting() | {"grid": grid}, inputs, [], {}, arguments)

    def given(self, name: str, frame: int) -> Node:
        """The rows that the decomposition has no part in; true materials are kept for the stages' own errors."""
        rows = [row.name for row in self._present(name) if row.given and row.source != "blender"]
        arguments = self._arguments(name, rows, strip=frame == self.shown(name), keep=GIVEN_KEPT)
        return self._pictures(f"given.{name}", frame, arguments, [], {})

    def reference(self, name: str, frame: int) -> Node:
        """Blender's own row, apart from the others since it is rendered last."""
        arguments = self._arguments(name, [row.name for row in self._present(name) if row.source == "blender"])
        return self._pictures(f"reference.{name}", frame, arguments, [], {}, PROXY)

    def early(self, name: str) -> dict[int, Path]:
        """Truths of a map whose light paths end after so many bounces."""
        return self.subject.early_paths(name, self.shown(name))

    def bounces(self, name: str) -> Node:
        """What each further bounce is worth."""
        arguments = self._arguments(name, [])
        told = {f"bounces {number}": _digest(path) for number, path in self.early(name).items()}
        node = self._pictures(f"bounces.{name}", self.shown(name), arguments, [], {})
        return replace(node, fields={**node.fields, "truths": told})

    def judge(self, name: str, frame: int, keys: Keys) -> Node:
        """The rows that the decomposition has a part in, or on frames between only those of the film."""
        thorough = frame in self.judged(name)
        own = [row for row in self._present(name) if not row.given and row.group != "ladder"]
        rows = [row.name for row in own if thorough or row.name in FILMED]
        upstream = [(f"given.{name}", frame)] if thorough else []
        upstream += [("exact", frame)] if thorough and self.exact_arrays else []
        if not self.lacking:
            upstream += [("decompose", frame), ("solve", frame)]
        strip = not self.lacking and frame == self.shown(name)
        keep = FILMED if self.filmed(name) else ()
        arguments = self._arguments(name, rows, thorough=thorough, strip=strip, keep=keep)
        return self._pictures(f"judge.{name}", frame, arguments, upstream, keys)

    def steps(self, name: str, frame: int, keys: Keys) -> Node:
        """The ladder with own materials, which costs more than all else and is wanted last."""
        rows = [row.name for row in self._present(name) if not row.given and row.group == "ladder"]
        return self._pictures(f"steps.{name}", frame, self._arguments(name, rows), [("solve", frame)], keys)

    def _present(self, name: str) -> list[Row]:
        """Rows that can be had under a map, but for the constants, which are known later."""
        absent, later = self.absent(name), ("constant", "own_constant")
        rows = [row for row in ROWS.values() if row.name not in absent and row.source not in later]
        return [row for row in rows if row.group != "ladder" or name in self.probed]

    def shown(self, name: str) -> int:
        """The frame whose pictures stand on the page."""
        judged = self.judged(name)
        return judged[len(judged) // 2]

    def _arguments(self, name: str, rows: list[str], **more: Any) -> dict[str, Any]:
        plain = {"map": name, "rows": rows, "thorough": True, "constants": {}, "strip": False, "keep": ()}
        return {**plain, "lpips": None if self.lpips is None else str(self.lpips), **more}

    def flat(self, name: str, frame: int, constants: Mapping[str, tuple[float, float]]) -> Node:
        """The rows of constant materials."""
        arguments = self._arguments(name, list(constants), constants=dict(constants))
        return self._pictures(f"flat.{name}", frame, arguments, [], {})

    def film(self, name: str, keys: Keys) -> Node:
        """Numbers of the films of a map."""
        upstream = [(f"judge.{name}", frame) for frame in self.frames]
        inputs = self._truth_files() | self._shot_files(self.frames)
        for frame in self.frames:
            inputs[f"relit {frame}"] = _digest(self.subject.relit_path(name, frame))
        return self._node(
            f"film.{name}", self.frames[:1], {"nets": self._nets()}, inputs, upstream, keys, {"map": name}
        )

    def _pictures(
        self,
        stage: str,
        frame: int,
        arguments: dict[str, Any],
        upstream: list[tuple[str, int]],
        keys: Keys,
        judged: str = RELIT,
    ) -> Node:
        told = {k: list(v) if isinstance(v, tuple) else v for k, v in arguments.items() if k != "lpips"}
        arguments = {**arguments, "shot": self._shot_digest(frame)}
        settings = self._relighting() | {"told": told, "nets": self._nets()}
        inputs = self._picture_files(arguments["map"], frame)
        if judged == PROXY:
            inputs["blender proxy"] = _digest(self.subject.relit_path(arguments["map"], frame, PROXY))
        return self._node(stage, (frame,), settings, inputs, upstream, keys, arguments)

    def _nets(self) -> dict[str, str]:
        weights = stlpips_weights()
        known = {"stlpips": weights, "lpips": self.lpips}
        return {name: _digest(path) for name, path in known.items() if path is not None}

    def _relighting(self) -> dict[str, Any]:
        shot = self.session.job.shot
        capture = shot.capture_light.model_dump(mode="json") if shot.capture_light else None
        return {"relight": dataclasses.asdict(of.relight_settings(shot)), "capture": capture}

    def _picture_files(self, name: str, frame: int) -> dict[str, str]:
        truth = {
            "env": self.subject.env_path(name), "relit": self.subject.relit_path(name, frame),
            "material": self.subject.material_path(frame),
        }  # fmt: skip
        return self._shot_files((frame,)) | {role: _digest(path) for role, path in truth.items()}

    def _shot_digest(self, frame: int) -> str:
        """What the scene of a frame is remembered by in a worker."""
        return key_of({"root": self.session.job.root, "files": self._shot_files((frame,)), **self._relighting()})

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
        stage: str,
        frames: tuple[int, ...],
        settings: Mapping[str, Any],
        inputs: Mapping[str, str],
        upstream: list[tuple[str, int]],
        keys: Keys,
        arguments: Mapping[str, Any],
    ) -> Node:
        # Tasks call these stages' kernels themselves, so their versions are part of the key.
        kernels = {name: STAGES[name].version for name in ("solve", "relight")}
        fields = {
            "stage": stage, "evaluation": VERSION, "kernels": kernels,
            "settings": dict(settings), "inputs": dict(inputs),
            "upstream": {f"{name} {frame}": keys[name, frame] for name, frame in upstream},
        }  # fmt: skip
        needs = tuple(dict.fromkeys(self._node_of(name, frame) for name, frame in upstream))
        index = self.session.job.position(frames[0])
        return Node(stage, index, frames, fields, needs, {**arguments, "subject": self.subject})

    def _node_of(self, stage: str, frame: int) -> NodeId:
        """The node that commits a frame of a stage, the product's or the evaluation's."""
        position = self.session.job.position(frame)
        if stage == "exact":
            return (stage, 0)
        if stage != "solve":
            return (stage, position)
        return (stage, self.session.plan().exchange.index_of(stage, position))


@lru_cache(maxsize=100_000)
def _digest(path: Path) -> str:
    return file_digest(path)
