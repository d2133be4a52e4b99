"""The evidence of a capture with other settings than the shot's, in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.files import camera_files
from yesnt.capture.pictures import read_view
from yesnt.capture.plan import plan_capture
from yesnt.core.capture_input import EvidenceInput
from yesnt.core.shot import Job
from yesnt.decompose.evidence.carry import carried_evidence
from yesnt.decompose.evidence.frame import measure_frame
from yesnt.decompose.evidence.precompile import precompile_evidence
from yesnt.decompose.evidence.records import FrameEvidence
from yesnt.decompose.settings import EnsembleSettings, keyframe_after
from yesnt.io.cameras import cameras_of
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.measure.trade.harness import Found, Harness, Spent, true_materials
from yesnt.measure.trade.variants import Variant, evidence_variants
from yesnt.planning import settings as of
from yesnt.relight import ProxyScene
from yesnt.runtime.session import Session
from yesnt.tasks.evidence_inputs import evidence_inputs
from yesnt.tasks.light import LightFiles
from yesnt.tasks.relight_inputs import proxy_scene, read_proxy

F32 = NDArray[np.float32]


@dataclass
class EvidenceRunner:
    """Runs variants of the evidence; measured frames are cached, since variants share them.

    Attributes:
        harness: of the compared frames, and of all up to the last keyframe that one of them uses.
        compared: positions of the frames that are compared.
        base: settings of the other stages.
        variants: what is tried.
    """

    harness: Harness
    compared: range
    base: Variant
    variants: list[Variant]
    _measured: dict[tuple[Any, ...], tuple[FrameEvidence, float]] = field(default_factory=dict)
    _estimate: tuple[F32, F32] | None = None

    @classmethod
    def of(cls, session: Session, frames: tuple[int, ...], base: Variant) -> EvidenceRunner | None:
        """For the capture of a shot; None if no camera measures it."""
        job = session.job
        if not session.resolved.capture.views:
            return None
        precompile_evidence()  # else the first variant would be charged with it
        finest = _finest(job)
        variants = evidence_variants(_most_cameras(job, finest), finest, job.shot.evidence)
        first, last = job.position(frames[0]), job.position(frames[-1])
        coarsest = max(v.evidence.every for v in variants if v.evidence is not None)
        stop = keyframe_after(last, len(job.frames), coarsest) + 1
        return cls(Harness(session, job.frames[first:stop]), range(len(frames)), base, variants)

    def __call__(self, variant: Variant) -> Found:
        """The compared frames under a variant, and its seconds per frame of the whole shot."""
        assert variant.evidence is not None
        mean, std, seconds = self._observed(variant.evidence)
        fused, _ = self.harness.fuse(mean, std, variant.method, variant.tolerance)
        return Found(self._shown(fused, variant.quality), seconds)

    def truth(self, stage: str) -> F32 | None:
        """The compared frames relit with true materials; None without truth."""
        planes = true_materials(self.harness, self.compared)
        return None if planes is None else self._shown(planes, self.base.quality)

    def _shown(self, planes: F32, quality: str) -> F32:
        return np.concatenate([self.harness.shown(planes, quality, p)[0] for p in self.compared])

    def _observed(self, evidence: EvidenceInput) -> tuple[F32, F32, float]:
        """Mean and standard deviation [2, T, H, W], and seconds per frame of the whole shot."""
        mean, std = (planes.copy() for planes in self._model())
        job = _with_evidence(self.harness.session.job, evidence)
        views, length = plan_capture(job, shot_camera(job)).views, len(job.frames)
        first, measuring, carrying = job.position(self.harness.frames[0]), list[float](), list[float]()
        for place in range(len(self.harness.frames)):
            key = keyframe_after(first + place, length, evidence.every) - first
            if key >= len(self.harness.frames):
                continue  # after the compared frames
            found, seconds = self._measure(key, views[job.frames[first + key]], evidence)
            measuring.append(seconds)
            if key != place:
                found, seconds = self._carried(found, place, key, job)
                carrying.append(seconds)
            mean[:, place], std[:, place] = found.mean, found.std
        share = len({keyframe_after(p, length, evidence.every) for p in range(length)}) / length
        spent = share * float(np.mean(measuring)) + (1 - share) * float(np.mean(carrying or [0]))
        return mean, std, spent

    def _model(self) -> tuple[F32, F32]:
        """The backend's estimate and its spread, by the base settings."""
        if self._estimate is None:
            mean, std, _ = self.harness.observe(self.base.ensemble, self.base.knobs, self.base.method)
            self._estimate = mean, std
        return self._estimate

    def _measure(self, position: int, names: Sequence[str], evidence: EvidenceInput) -> tuple[FrameEvidence, float]:
        """A frame measured by cameras, and its processor seconds."""
        at = position, tuple(names), tuple(sorted(evidence.knobs.items()))
        if at not in self._measured:
            job, frame, spent = self.harness.session.job, self.harness.frames[position], Spent()
            mean, std = (planes[:, position] for planes in self._model())
            capture = job.shot.captured
            assert capture is not None
            cameras, relight = cameras_of(job.root, capture), of.relight_settings(job.shot)
            views = [read_view(job, name, cameras[name], frame) for name in names]
            settings = of.evidence_settings(_with_evidence(job, evidence).shot)
            with spent.counted():
                bare = replace(self.harness.bare(position), proxy=proxy_scene(read_proxy(job, frame), ProxyScene))
                inputs = evidence_inputs(bare, (mean, std), views, LightFiles.read(job, frame), relight)
                found = measure_frame(inputs, relight, settings)
            self._measured[at] = found, spent.seconds
        return self._measured[at]

    def _carried(self, found: FrameEvidence, place: int, key: int, job: Job) -> tuple[FrameEvidence, float]:
        """The materials of a keyframe in an earlier frame, and the processor seconds of taking them there."""
        spent, links = Spent(), self.harness.links(self.base.method)[0][place:key]
        mattes = [self.harness.mattes[p] for p in range(place, key + 1)]
        mean, std = (planes[:, place] for planes in self._model())
        plate, settings = self.harness.plates[place].color, of.evidence_settings(job.shot)
        with spent.counted():
            carried = carried_evidence(found, (mean, std), (links, mattes), EnsembleSettings(), plate, settings)
        return carried, spent.seconds


def _with_evidence(job: Job, evidence: EvidenceInput) -> Job:
    return job.model_copy(update={"shot": job.shot.model_copy(update={"evidence": evidence})})


def _finest(job: Job) -> int:
    """Least step from one measured frame to the next for which every camera has its files, at most the job's own."""
    capture, own, length = job.shot.captured, job.shot.evidence.every, len(job.frames)
    assert capture is not None

    names = list(cameras_of(job.root, capture))

    def complete(every: int) -> bool:
        keys = {job.frames[keyframe_after(p, length, every)] for p in range(length)}
        files = (camera_files(job.root, capture, name, frame) for name in names for frame in keys)
        return all(path.is_file() for of_one in files for path in of_one.values())

    return next((every for every in range(1, own) if complete(every)), own)


def _most_cameras(job: Job, every: int) -> int:
    """Cameras that every measured frame can have beside the plate's own."""
    asked = EvidenceInput(use=True, cameras=256, every=every)
    return min(len(names) for names in plan_capture(_with_evidence(job, asked), shot_camera(job)).views.values())
