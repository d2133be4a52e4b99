"""The stage table and the keys: what each stage reads, writes, and depends on.

A key holds the stage's code version, the settings that matter to it, the digests of the input files that it reads and
the keys of what it takes from other stages. So a key can be told before anything runs, and `plan` and `explain` read
the same fields that decide.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from yesnt import settings as of
from yesnt.blocks import Block, chunk_blocks
from yesnt.chunks import ChunkPlan
from yesnt.decompose.identity import BackendIdentity
from yesnt.graph import Node
from yesnt.io.jobfile import frame_path
from yesnt.io.records import key_of
from yesnt.shot import Job

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
        Stage("decompose", 1, "frame", "plate", ("observed", "spread")),
        Stage("flow", 1, "frame and the next", "two plates", ("flow", "validity")),
        Stage("solve", 1, "chunk with halo", "observed, spread, flow, validity", ("material",)),
        Stage("relight", 1, "frame", "plate, G-buffer, proxy, material, light",
              ("base_color", "diffuse", "specular", "shadow")),
        Stage("composite", 1, "frame", "diffuse, specular, background"),
        Stage("preview", 1, "shot", "the EXR sequence"),
    )
}  # fmt: skip
"""Every stage by name, in order."""


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
    def blocks(self) -> tuple[Block, ...]:
        """Chunks with their halo, in positions of the sequence."""
        return chunk_blocks(len(self.job.frames), self.job.shot.temporal.chunk, self.chunks.halo)

    def sweeps(self) -> Iterator[tuple[int, tuple[Block, ...]]]:
        """The first solve (0) and then the exchanges between neighbouring chunks."""
        for sweep in range(self.sweep_count):
            yield sweep, self.blocks

    @property
    def sweep_count(self) -> int:
        """Solves of each chunk."""
        return 1 if len(self.blocks) == 1 else 1 + self.chunks.sweeps

    def solve_stage(self, sweep: int) -> str:
        """The last sweep is the stage `solve`; those before it are `solve.0`, `solve.1`, ..."""
        return "solve" if sweep == self.sweep_count - 1 else f"solve.{sweep}"

    def arrays(self) -> dict[str, str]:
        """Arrays of the store and the channel that each holds."""
        arrays = {name: name for stage in STAGES.values() for name in stage.arrays}
        return arrays | {f"solve.{sweep}": "material" for sweep in range(self.sweep_count - 1)}

    @cached_property
    def job_digest(self) -> str:
        """Hash of the job's settings; the EXR headers carry it."""
        return key_of(self.job.shot.model_dump(mode="json", exclude={"output": True, "decompose": {"accept_license"}}))

    def decompose(self, frame: int) -> Node:
        """Members of one frame, their mean and spread."""
        shot = self.job.shot
        settings: dict[str, Any] = {"path": shot.decompose.path is not None}
        inputs = self._inputs(frame, plate=shot.plate.path, passes=shot.decompose.path)
        if self.backend is not None:
            settings = {
                "backend": dataclasses.asdict(self.backend),
                "ensemble": dataclasses.asdict(of.ensemble_settings(shot)),
                "seed": shot.seed,
            }
        return self._node("decompose", frame, settings | {"colorspace": shot.plate.colorspace}, inputs)

    def flow(self, frame: int) -> Node:
        """Flow of one frame to the next, and where it can be trusted."""
        shot = self.job.shot
        after = self.job.frames[self.job.position(frame) + 1]
        inputs = self._inputs(frame, plate=shot.plate.path, flow=shot.flow.path)
        inputs |= self._inputs(after, next_plate=shot.plate.path, next_flow=shot.flow.path)
        settings = {"flow": dataclasses.asdict(of.flow_settings(shot)), "colorspace": shot.plate.colorspace}
        return self._node("flow", frame, settings, inputs)

    def solve(self, sweep: int, block: Block, keys: Keys) -> Node:
        """One chunk of the temporal solve; later sweeps take their neighbours' border frames from the sweep before."""
        frames = self.job.frames
        loaded = self.chunks.loaded(block, len(frames), sweep)
        upstream = [("decompose", frames[p]) for p in loaded if frames[p] not in self.absent]
        upstream += [("flow", frames[p]) for p in loaded[:-1] if frames[p] not in self.unlinked]
        previous = self.solve_stage(sweep - 1) if sweep else None
        if previous is not None:
            upstream += [(previous, frames[p]) for p in loaded]
            upstream += [(self.solve_stage(sweep - 2), frames[p]) for p in loaded if sweep > 1]
        shot = self.job.shot
        settings = {
            "energy": dataclasses.asdict(of.energy_params(shot)),
            "temporal": shot.temporal.model_dump(mode="json", include={"enabled", "method", "tolerance", "robust"}),
            "block": [block.core.start, block.core.stop, block.outer.start, block.outer.stop],
            "absent": sorted(self.absent & {frames[p] for p in loaded}),
            "sweep": sweep,
        }
        stage = self.solve_stage(sweep)
        arguments = {
            "block": block,
            "loaded": (loaded.start, loaded.stop),
            "previous": previous,
            "before_previous": self.solve_stage(sweep - 2) if sweep > 1 else None,
            "absent": tuple(self.absent),
            "unlinked": tuple(self.unlinked),
        }
        fields = self._fields(stage, settings, {}, upstream, keys)
        needs = tuple(dict.fromkeys(self._node_of(name, frame) for name, frame in upstream))
        core = tuple(frames[p] for p in block.core)
        return Node(stage, block.index, core, fields, needs, arguments, transient=stage != "solve")

    def relight(self, frame: int, keys: Keys) -> Node:
        """One frame with the capture light taken out and the new light put in."""
        shot = self.job.shot
        capture = shot.capture_light
        inputs = self._inputs(
            frame, plate=shot.plate.path, gbuffer=shot.gbuffer.path, proxy=shot.proxy.path if shot.proxy else None,
            light=shot.light.path, capture=capture.path if capture else None, camera=shot.camera,
        )  # fmt: skip
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
        inputs = self._inputs(frame, background=shot.background.path if shot.background else None)
        settings = {
            "name": shot.name,
            "exr": shot.exr.model_dump(mode="json"),
            "background": shot.background.colorspace if shot.background else "light",
            "job": self.job_digest,
        }
        upstream = [("relight", frame), ("decompose", frame)]
        return self._node("composite", frame, settings, inputs, upstream, keys, {"job_digest": self.job_digest})

    def preview(self, keys: Keys) -> Node:
        """A film and a contact sheet of what was delivered."""
        upstream = [("composite", f) for f in self.delivered]
        fields = self._fields("preview", {"name": self.job.shot.name}, {}, upstream, keys)
        needs = tuple(self._node_of(stage, frame) for stage, frame in upstream)
        return Node("preview", 0, (self.job.frames[0],), fields, needs, {"frames": self.delivered})

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
        position = self.job.position(frame)
        if stage_of(stage).name != "solve":
            return (stage, position)
        return (stage, next(b.index for b in self.blocks if b.core.start <= position < b.core.stop))

    def _inputs(self, frame: int, **patterns: str | None) -> dict[str, str]:
        return {
            name: self.digests[str(frame_path(self.job.root, pattern, frame))]
            for name, pattern in patterns.items()
            if pattern is not None
        }
