"""A shot as the builders of its nodes see it: frames of each stage, the solver's schedule, digests of inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from yesnt.core.blocks import Chunks
from yesnt.core.channels import OF_THE_SUN
from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.decompose.evidence.settings import OFFSETS
from yesnt.decompose.identity import BackendIdentity
from yesnt.decompose.settings import EnsembleSettings, keyframes_taken
from yesnt.decompose.window import Window, plan_windows
from yesnt.io.jobfile import frame_path, has_frame_number
from yesnt.io.records import digest_of
from yesnt.io.store_layout import ArrayForm
from yesnt.planning import settings as of
from yesnt.planning.chunks import ChunkPlan
from yesnt.planning.exchange import Exchange
from yesnt.planning.keyed_settings import changed_keys
from yesnt.planning.stages import BAKE, CORRECT, DECOMPOSE, EVIDENCE, GROUND, SET, STAGES, Stage
from yesnt.planning.task_records import Gaps
from yesnt.temporal.outliers import OUTLIER_HALO

Awaiting = Literal["", "mattes", "views"]
"""What a run makes first, since other stages read it like files of the user; empty: nothing any more."""

MATTES: Awaiting = "mattes"
VIEWS: Awaiting = "views"

CONFIDENCE_CHUNK = 16
"""Frames of a confidence task, where the job does not say."""


@dataclass(frozen=True)
class ShotPlan:
    """Frames of each stage, the solver's schedule, and digests of inputs.

    Attributes:
        job: the job.
        digests: path as resolved -> digest, for every input file.
        backend: name, version and weights digest of the decomposition; None if passes are read.
        chunks: how the solver's chunks are cut.
        absent: frames whose decomposition is dead: they are solved without data and not delivered.
        unlinked: frames whose flow is dead: the solver gets no link there.
        undelivered: frames whose relighting or chunk is dead.
        views: frame -> cameras of the capture that measure it; empty if none do (capture/plan.py).
        awaiting: what is still to be made before the rest is known of: `MATTES`, or `VIEWS` (plates and what belongs to
            them, from Gaussian fields).
        unfitted: frames whose fit failed in an earlier pass.
    """

    job: Job
    digests: Mapping[str, str]
    backend: BackendIdentity | None
    chunks: ChunkPlan
    absent: frozenset[int] = frozenset()
    unlinked: frozenset[int] = frozenset()
    undelivered: frozenset[int] = frozenset()
    views: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    awaiting: Awaiting = ""
    unfitted: frozenset[int] = frozenset()

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

    @property
    def observed(self) -> StageId:
        """The stage whose materials the temporal solve observes."""
        return CORRECT if self.job.shot.corrected else self.estimated

    @property
    def estimated(self) -> StageId:
        """The stage whose materials are corrected, if the job corrects them."""
        return EVIDENCE if self.views or self.moments else DECOMPOSE

    @cached_property
    def evidence_keyframes(self) -> Mapping[int, int]:
        """Frame that is not measured -> the later frame whose measured materials it takes along the flow."""
        found = keyframes_taken(self.job.frames, self.job.shot.evidence.every, self.absent, self.unlinked)
        return found if self.job.shot.evidence.time else {f: key for f, key in found.items() if key in self.views}

    @property
    def base_from_views(self) -> bool:
        """Whether the capture's cameras tell of the base colour too: in all frames or in none, lest they flicker.

        Materials that an artist corrects are not those that the cameras were explained by.
        """
        measured = bool(self.views) and all(frame in self.views for frame in self.delivered)
        return measured and not self.job.shot.corrected and self.job.shot.relight.get("base_color") != "plate"

    @cached_property
    def moments(self) -> Mapping[int, tuple[int, ...]]:
        """Frame that is measured over time -> the other frames of the camera that measure it; empty if none is."""
        if not self.job.shot.evidence.time:
            return {}
        measured = (frame for frame in self.present if frame not in self.evidence_keyframes)
        return {frame: self._moments_of(frame) for frame in measured}

    def _moments_of(self, frame: int) -> tuple[int, ...]:
        """Frames that the flow links to a frame without a gap, the nearest first."""
        frames, place = self.job.frames, self.job.position(frame)
        found = []
        for offset in OFFSETS:
            other = place + offset
            way = frames[min(place, other) : max(place, other)] if 0 <= other < len(frames) else ()
            if way and self.unlinked.isdisjoint(way) and frames[other] not in self.absent:
                found.append(frames[other])
        return tuple(found[: self.job.shot.evidence.cameras])

    def _runs(self, row: Stage) -> bool:
        """Whether the job has tasks of an optional stage."""
        shot = self.job.shot
        with_set = {SET} if shot.set is not None else set()
        with_set |= {GROUND} if shot.built_in_set is not None else set()
        with_set |= {BAKE} if shot.light.set else set()
        return not row.optional or StageId(row.name) in {self.estimated, self.observed, *with_set}

    @property
    def gaps(self) -> Gaps:
        """Frames that the solver does without."""
        return Gaps(self.absent, self.unlinked)

    @cached_property
    def exchange(self) -> Exchange:
        """Which block is solved when."""
        return Exchange(len(self.job.frames), self.chunks)

    @property
    def confidence_chunks(self) -> Chunks:
        """Chunks of the confidence tasks: short enough to keep all workers busy, whatever the solver's chunks are."""
        length = self.job.shot.temporal.chunk or CONFIDENCE_CHUNK
        return Chunks(len(self.job.frames), length, OUTLIER_HALO)

    def arrays(self) -> dict[str, ArrayForm]:
        """Arrays of the store and the channel that each holds; for bands with their rows."""
        arrays: dict[str, ArrayForm] = {}
        for row in filter(self._runs, STAGES.values()):
            lanes = self.lanes if row.in_lanes else (StageId(row.name),)
            arrays |= {stage.array(channel): channel for stage in lanes for channel in row.channels}
        if not self.job.shot.light_groups:
            arrays = {name: form for name, form in arrays.items() if form not in OF_THE_SUN}
        return arrays | self.exchange.arrays()

    @cached_property
    def job_digest(self) -> str:
        """Hash of the job's settings; the EXR headers carry it."""
        shot, left = self.job.shot, {"accept_license"}
        if shot.decompose.samples == EnsembleSettings().samples:  # was the default of all backends: headers stay
            left |= {"samples"}
        settings = changed_keys(shot, {"output": True, "decompose": left, "color": {"config"}})
        return digest_of({name: value for name, value in settings.items() if value != {}})

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """Windows of a video backend; none of another."""
        if self.backend is None or not self.backend.footprint.window:
            return ()
        return plan_windows(len(self.job.frames), self.backend.footprint)

    @property
    def lanes(self) -> tuple[StageId, ...]:
        """Stages that store windows."""
        return tuple(StageId("window", lane=lane) for lane in sorted({window.lane for window in self.windows}))

    @cached_property
    def keyframes(self) -> Mapping[int, int]:
        """Frame -> the keyframe whose estimate it takes (decompose/settings.py)."""
        if self.backend is None or self.windows:
            return {}
        step = of.ensemble_settings(self.job.shot).keyframe_step
        return keyframes_taken(self.job.frames, step, self.absent, self.unlinked)

    def inputs(self, frame: int, **patterns: str | None) -> dict[str, str]:
        """Digests of a frame's input files, by role; patterns that the job does not have are left out."""
        return {role: self._digest(pattern, frame) for role, pattern in patterns.items() if pattern is not None}

    def plate_inputs(self, frame: int, prefix: str = "", suffix: str = "") -> dict[str, str]:
        """Digests of the files that a frame's plate is read from, by role: the plate, and a matte of its own."""
        shot = self.job.shot
        found = self.inputs(frame, plate=shot.plate.path, matte=shot.matte.path if shot.matte else None)
        return {f"{prefix}{role}{suffix}": digest for role, digest in found.items()}

    @cached_property
    def plate_settings(self) -> dict[str, dict[str, Any]]:
        """Sections of settings that the reading of plates depends on, for the keys."""
        shot = self.job.shot
        matte = {"matte": changed_keys(shot.matte, {"path"})} if shot.matte else {}
        return {"plate": changed_keys(shot.plate, {"path"}), **matte, "color": self.job.colors.digests("plate")}

    def _digest(self, pattern: str, frame: int) -> str:
        by_frame = self._digests_of.setdefault(pattern, {})
        named = frame if has_frame_number(pattern) else 0  # else one file serves all frames
        if named not in by_frame:
            by_frame[named] = self.digests[str(frame_path(self.job.root, pattern, named))]
        return by_frame[named]

    @cached_property
    def _digests_of(self) -> dict[str, dict[int, str]]:
        """Pattern -> frame -> digest, as far as it was asked for: several stages read the same files."""
        return {}
