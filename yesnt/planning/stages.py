"""The stage table and the keys: what each stage reads, writes, and depends on.

A key holds the stage's code version, the settings that matter to it, the digests of the input files that it reads and
the keys of what it takes from other stages. So a key can be told before anything runs, and `plan` and `explain` read
the same fields that decide.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from yesnt.core.blocks import Block, Span, chunk_blocks
from yesnt.core.shot import Job
from yesnt.decompose.identity import BackendIdentity
from yesnt.decompose.settings import REUSE_ONLY, keyframes_taken
from yesnt.decompose.window import Window, plan_windows
from yesnt.io.jobfile import frame_path, pass_patterns
from yesnt.io.preview import SEGMENT_FRAMES
from yesnt.io.records import key_of
from yesnt.io.store import ArrayForm
from yesnt.planning import settings as of
from yesnt.planning.chunks import ROUND, ChunkPlan
from yesnt.planning.exchange import Exchange
from yesnt.planning.graph import Node
from yesnt.temporal.outliers import OUTLIER_HALO

Keys = Mapping[tuple[str, int], str]


@dataclass(frozen=True)
class Stage:
    """A row of the table.

    Attributes:
        name: the word in keys, records, logs, dashboard.
        version: of its code; raised when its result changes, which makes every older record stale.
        per: what one task holds.
        reads: in words.
        arrays: arrays of the frame store that it writes.
    """

    name: str
    version: int
    per: str
    reads: str
    arrays: tuple[str, ...] = ()


STAGES = {
    stage.name: stage
    for stage in (
        Stage("window", 1, "window of frames (video backends)", "plates"),
        Stage("decompose", 3, "frame", "plate; between keyframes also a keyframe and the flow to it; or its windows",
              ("observed", "spread", "evaluations")),
        Stage("flow", 2, "frame and the next", "two plates", ("flow", "validity")),
        Stage("trust", 3, "chunk with halo", "observed, spread, flow, validity", ("confidence",)),
        Stage("solve", 5, "shot; if long, chunk with halo; bands of rows", "observed, confidence, flow, validity",
              ("material",)),
        Stage("relight", 8, "frame", "plate, G-buffer, proxy, material, light",
              ("base_color", "diffuse", "specular", "shadow")),
        Stage("composite", 1, "frame", "diffuse, specular, background"),
        Stage("preview", 4, "second of video; then the shot", "the EXR sequence"),
    )
}  # fmt: skip
"""Every stage by name, in order."""


TRUST_CHUNK = 16
"""Frames of a task that tells trust, where the job does not say."""


def stage_of(name: str) -> Stage:
    """The row of a node's stage: sweeps of the solver (`solve.0`) are the stage `solve`."""
    return STAGES[name.partition(".")[0]]


@dataclass(frozen=True)
class ShotPlan:
    """Builds the nodes of a shot.

    Attributes:
        job: the job.
        digests: path as resolved -> digest, for every input file.
        backend: name, version and weights digest of the decomposition; None if passes are read.
        chunks: how the solver's chunks are cut.
        absent: frames whose decomposition is dead: they are solved without data and not delivered.
        unlinked: frames whose flow is dead: the solver gets no link there.
        undelivered: frames whose relighting or chunk is dead.
    """

    job: Job
    digests: Mapping[str, str]
    backend: BackendIdentity | None
    chunks: ChunkPlan
    absent: frozenset[int] = frozenset()
    unlinked: frozenset[int] = frozenset()
    undelivered: frozenset[int] = frozenset()

    @cached_property
    def present(self) -> tuple[int, ...]:
        """Frames that are decomposed."""
        return tuple(f for f in self.job.frames if f not in self.absent)

    @cached_property
    def delivered(self) -> tuple[int, ...]:
        """Frames that are relit and written."""
        return tuple(f for f in self.present if f not in self.undelivered)

    @cached_property
    def linked(self) -> tuple[int, ...]:
        """Frames that have flow to the next."""
        return tuple(f for f in self.job.frames[:-1] if f not in self.unlinked)

    @cached_property
    def exchange(self) -> Exchange:
        """Which block is solved when."""
        return Exchange(len(self.job.frames), self.chunks)

    @cached_property
    def trusted(self) -> tuple[Block, ...]:
        """Frames whose trust one task tells: as many as keep all workers busy, whatever the solver's chunks are."""
        length = self.job.shot.temporal.chunk or TRUST_CHUNK
        return chunk_blocks(len(self.job.frames), length, OUTLIER_HALO)

    def arrays(self) -> dict[str, ArrayForm]:
        """Arrays of the store and the channel that each holds; for bands with their rows."""
        arrays: dict[str, ArrayForm] = {name: name for stage in STAGES.values() for name in stage.arrays}
        for lane in sorted({window.lane for window in self.windows}):
            arrays |= {f"window.{lane}.{name}": name for name in ("observed", "spread")}
        return arrays | self.exchange.arrays()

    @cached_property
    def job_digest(self) -> str:
        """Hash of the job's settings; the EXR headers carry it."""
        return key_of(self.job.shot.model_dump(mode="json", exclude={"output": True, "decompose": {"accept_license"}}))

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """Windows of a video backend; none of another."""
        if self.backend is None or not self.backend.footprint.window:
            return ()
        return plan_windows(len(self.job.frames), self.backend.footprint)

    @cached_property
    def keyframes(self) -> Mapping[int, int]:
        """Frame -> the keyframe whose estimate it takes (decompose/settings.py)."""
        if self.backend is None or self.windows:
            return {}
        step = of.ensemble_settings(self.job.shot).keyframe_step
        return keyframes_taken(self.job.frames, step, self.absent, self.unlinked)

    def window(self, window: Window) -> Node:
        """Members of a window of frames, their mean and spread a frame."""
        shot = self.job.shot
        frames = tuple(self.job.frames[p] for p in window.span)
        settings = self._sampling() | {"colorspace": shot.plate.colorspace, "frames": frames}
        inputs: dict[str, str] = {}
        for frame in frames:
            inputs |= self._inputs(frame, **{f"plate {frame}": shot.plate.path})
        fields = self._fields("window", settings, inputs, [], {})
        return Node(f"window.{window.lane}", window.index, frames, fields, transient=True)

    def _sampling(self) -> dict[str, Any]:
        """What a full draw depends on beside its pictures."""
        assert self.backend is not None
        ensemble = dataclasses.asdict(of.ensemble_settings(self.job.shot))
        return {
            "backend": dataclasses.asdict(self.backend),
            "ensemble": {name: value for name, value in ensemble.items() if name not in REUSE_ONLY},
            "seed": self.job.shot.seed,
        }

    def decompose(self, frame: int, keys: Keys) -> Node:
        """Members of one frame, their mean and spread; between keyframes only what the keyframe cannot tell."""
        shot, position, keyframe = self.job.shot, self.job.position(frame), self.keyframes.get(frame)
        settings: dict[str, Any] = {"passes": "made before"} if self.backend is None else self._sampling()
        settings["colorspace"] = shot.plate.colorspace
        passes = pass_patterns(shot.decompose.path) if shot.decompose.path else {}
        inputs = self._inputs(frame, plate=shot.plate.path, **passes)
        covering = [w for w in self.windows if position in w.span]
        mix = {f"window.{w.lane}": w.weights[position - w.span.start] for w in covering}
        upstream = [(stage, frame) for stage in mix]
        if keyframe is not None:
            settings["reuse"] = {name: getattr(of.ensemble_settings(shot), name) for name in REUSE_ONLY}
            way = self.job.frames[position : self.job.position(keyframe)]
            upstream = [("decompose", keyframe), *(("flow", f) for f in way)]
        arguments: dict[str, Any] = {"keyframe": keyframe, "mix": mix}
        if self.backend is not None and mix:  # network evaluations of a window's member, a frame
            arguments["cost"] = self.backend.footprint.nfe / self.backend.footprint.window
        return self._node("decompose", frame, settings | {"mix": mix}, inputs, upstream, keys, arguments)

    def flow(self, frame: int) -> Node:
        """Flow of one frame to the next, and where it can be trusted."""
        shot = self.job.shot
        after = self.job.frames[self.job.position(frame) + 1]
        inputs = self._inputs(frame, plate=shot.plate.path, flow=shot.flow.path, weights=shot.flow.weights)
        inputs |= self._inputs(after, next_plate=shot.plate.path)
        settings = {"flow": dataclasses.asdict(of.flow_settings(shot)), "colorspace": shot.plate.colorspace}
        return self._node("flow", frame, settings, inputs)

    def trust(self, block: Block, keys: Keys) -> Node:
        """The data weight of one chunk's frames: confidence, less where a frame contradicts its neighbours."""
        frames = self.job.frames
        loaded = range(block.outer.start, block.outer.stop)
        settings = {
            "robust": self.job.shot.temporal.robust,
            "absent": sorted(self.absent & {frames[p] for p in loaded}),
        }
        fields = self._fields("trust", settings, {}, self._material(loaded), keys)
        return self._chunk_node("trust", block, loaded, fields, {})

    def solve(self, sweep: int, block: Block, band: Block, keys: Keys) -> Node:
        """One block of the temporal solve; after sweep 0 it takes its neighbours' frames from the sweeps before."""
        frames, exchange, chunks = self.job.frames, self.exchange, self.chunks
        loaded = chunks.loaded(block, len(frames), sweep)
        last = max((k for k in exchange.solved_in(block.index, band.index) if k < sweep), default=0)
        bands = chunks.touched(band, sweep)
        now = {frames[p]: exchange.before(p, bands, sweep) for p in loaded} if sweep else {}
        then = {frames[p]: exchange.before(p, bands, last) for p in loaded} if last else {}
        settings = self._energy(loaded, sweep) | {
            "block": [block.core.start, block.core.stop, block.outer.start, block.outer.stop],
            "band": None if chunks.whole else [*dataclasses.astuple(band), chunks.reach],
        }
        stage = exchange.stage(block.index, band.index, sweep)
        fields = self._fields(stage, settings, {}, self._solved_from(loaded, now, then), keys)
        cut = {"bands": chunks.bands, "band": band.index, "reach": chunks.reach}
        return self._chunk_node(stage, block, loaded, fields, {"now": now, "then": then, **cut})

    def joint(self, sweep: int, keys: Keys) -> Node:
        """What the exchanges of a round still moved, in all frames at once."""
        frames, chunks = self.job.frames, self.chunks
        everything = Span(0, len(frames))
        bands = tuple(band.index for band in chunks.bands)
        now, then = (
            {frames[p]: self.exchange.before(p, bands, k) for p in everything} for k in (sweep, sweep - ROUND + 1)
        )
        cut = {"bands": chunks.bands, "reach": chunks.reach, "joint": chunks.joint}
        settings = self._energy(everything, sweep) | {"joint": chunks.joint, "reach": chunks.reach}
        stage = self.exchange.stage(0, 0, sweep)
        fields = self._fields(stage, settings, {}, self._solved_from(everything, now, then), keys)
        block, loaded = Block(0, everything, everything), range(len(frames))
        return self._chunk_node(stage, block, loaded, fields, {"now": now, "then": then, **cut})

    def _energy(self, loaded: Iterable[int], sweep: int) -> dict[str, Any]:
        """Settings of every solve."""
        shot, frames = self.job.shot, self.job.frames
        return {
            "energy": dataclasses.asdict(of.energy_params(shot)),
            "temporal": shot.temporal.model_dump(mode="json", include={"enabled", "method", "tolerance"}),
            "absent": sorted(self.absent & {frames[p] for p in loaded}),
            "sweep": sweep,
        }

    def _solved_from(self, loaded: Iterable[int], *held: Mapping[int, Mapping[int, str]]) -> list[tuple[str, int]]:
        """All that a solve reads."""
        positions = list(loaded)
        upstream = [("trust", self.job.frames[p]) for p in positions] + self._material(positions)
        upstream += [(stage, frame) for known in held for frame, by_band in known.items() for stage in by_band.values()]
        return list(dict.fromkeys(upstream))

    def join(self, block: Block, keys: Keys) -> Node:
        """The whole frames of a chunk that was solved in bands."""
        frames, bands = self.job.frames, tuple(band.index for band in self.chunks.bands)
        parts = {frames[p]: self.exchange.before(p, bands, 1 + self.exchange.sweeps) for p in block.core}
        upstream = [(stage, frame) for frame, held in parts.items() for stage in held.values()]
        fields = self._fields("solve", {"joined": len(bands)}, {}, upstream, keys)
        loaded = range(block.core.start, block.core.stop)
        return self._chunk_node("solve", block, loaded, fields, {"parts": parts, "bands": self.chunks.bands})

    def relight(self, frame: int, keys: Keys) -> Node:
        """One frame with the capture light taken out and the new light put in."""
        shot = self.job.shot
        capture = shot.capture_light
        inputs = self._inputs(
            frame, plate=shot.plate.path, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path if shot.proxy else None,
            light=shot.light.path, capture=capture.path if capture else None, camera=shot.camera,
        )  # fmt: skip
        for probe in self.job.probe_frames if capture and capture.estimate else ():
            seen = {f"probe plate {probe}": shot.plate.path, f"probe gbuffer {probe}": shot.gbuffer.path}
            inputs |= self._inputs(probe, **seen)
        settings = {
            "relight": dataclasses.asdict(of.relight_settings(shot)),
            "light": shot.light.model_dump(mode="json", exclude={"path"}),
            "capture": capture.model_dump(mode="json", exclude={"path"}) if capture else None,
            "gbuffer": shot.gbuffer.model_dump(mode="json", exclude={"path"}),
            "colorspace": shot.plate.colorspace,
        }
        return self._node("relight", frame, settings, inputs, [("solve", frame)], keys)

    def composite(self, frame: int, keys: Keys) -> Node:
        """One EXR."""
        shot = self.job.shot
        backdrop = {"background": shot.background.path} if shot.background else {"light": shot.light.path}
        inputs = self._inputs(frame, **backdrop)
        settings = {
            "name": shot.name,
            "exr": shot.exr.model_dump(mode="json"),
            "background": shot.background.colorspace if shot.background else "light",
            "job": self.job_digest,
        }
        upstream = [("relight", frame), ("decompose", frame)]
        return self._node("composite", frame, settings, inputs, upstream, keys, {"job_digest": self.job_digest})

    @property
    def segments(self) -> tuple[tuple[int, ...], ...]:
        """Delivered frames by the segment of the preview video that holds them."""
        starts = range(0, len(self.delivered), SEGMENT_FRAMES)
        return tuple(self.delivered[first : first + SEGMENT_FRAMES] for first in starts)

    def segment(self, index: int, keys: Keys) -> Node:
        """A segment of the preview video, encoded as soon as its frames are delivered."""
        frames = self.segments[index]
        upstream = [("composite", frame) for frame in frames]
        fields = self._fields("preview.segment", {"name": self.job.shot.name}, {}, upstream, keys)
        needs = tuple(self._node_of(stage, frame) for stage, frame in upstream)
        return Node("preview.segment", index, frames[:1], fields, needs, {"frames": frames}, transient=True)

    def preview(self, keys: Keys) -> Node:
        """The preview video and a contact sheet of what was delivered."""
        upstream = [("preview.segment", frames[0]) for frames in self.segments]
        fields = self._fields("preview", {}, {}, upstream, keys)
        numbers = tuple(range(len(self.segments)))
        needs = tuple(("preview.segment", number) for number in numbers)
        return Node("preview", 0, (self.job.frames[0],), fields, needs, {"segments": numbers})

    def _material(self, loaded: Sequence[int]) -> list[tuple[str, int]]:
        """What stages before the solver know of these positions."""
        frames = self.job.frames
        found = [("decompose", frames[p]) for p in loaded if frames[p] not in self.absent]
        return found + [("flow", frames[p]) for p in loaded[:-1] if frames[p] not in self.unlinked]

    def _chunk_node(
        self, stage: str, block: Block, loaded: range, fields: Mapping[str, Any], arguments: Mapping[str, Any]
    ) -> Node:
        frames = self.job.frames
        upstream = [name.split(" ") for name in fields["upstream"]]
        needs = tuple(dict.fromkeys(self._node_of(name, int(frame)) for name, frame in upstream))
        told = {
            "block": block,
            "loaded": (loaded.start, loaded.stop),
            "absent": tuple(sorted(self.absent)),
            "unlinked": tuple(sorted(self.unlinked)),
        }
        core = tuple(frames[p] for p in block.core)
        return Node(
            stage, block.index, core, fields, needs, told | dict(arguments), transient=stage.startswith("solve.")
        )

    def _node(
        self,
        stage: str,
        frame: int,
        settings: Mapping[str, Any],
        inputs: Mapping[str, str],
        upstream: list[tuple[str, int]] | None = None,
        keys: Keys | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> Node:
        fields = self._fields(stage, settings, inputs, upstream or [], keys or {})
        needs = tuple(dict.fromkeys(self._node_of(*need) for need in upstream or []))
        return Node(stage, self.job.position(frame), (frame,), fields, needs, arguments or {})

    def _fields(
        self,
        stage: str,
        settings: Mapping[str, Any],
        inputs: Mapping[str, str],
        upstream: list[tuple[str, int]],
        keys: Keys,
    ) -> dict[str, Any]:
        return {
            "stage": stage,
            "version": stage_of(stage).version,
            "size": [self.job.width, self.job.height],
            "settings": settings,
            "inputs": dict(inputs),
            "upstream": {f"{name} {frame}": keys[name, frame] for name, frame in upstream},
        }

    def _node_of(self, stage: str, frame: int) -> tuple[str, int]:
        """The node that commits a frame of a stage."""
        position, kind = self.job.position(frame), stage_of(stage).name
        if kind == "window":
            return (stage, next(w.index for w in self.windows if f"window.{w.lane}" == stage and position in w.span))
        if kind == "trust":
            return (stage, next(b.index for b in self.trusted if b.core.start <= position < b.core.stop))
        return (stage, self.exchange.index_of(stage, position) if kind == "solve" else position)

    def _inputs(self, frame: int, **patterns: str | None) -> dict[str, str]:
        return {
            name: self.digests[str(frame_path(self.job.root, pattern, frame))]
            for name, pattern in patterns.items()
            if pattern is not None
        }
