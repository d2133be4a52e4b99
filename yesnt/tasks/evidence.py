"""Tasks of the evidence: one frame measured by the capture's cameras, or taken from another along the flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.records import FrameEvidence
from yesnt.decompose.reuse import Link
from yesnt.planning import settings as of
from yesnt.planning.stages import DECOMPOSE, EVIDENCE, FLOW
from yesnt.planning.task_records import CarryEvidenceTask, MeasureTask, TrackTask
from yesnt.tasks.captured_views import captured_views
from yesnt.tasks.light import LightFiles
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]

WITHOUT = "evidence: pixels measured without a camera that contradicts the others (`left_out` of the record says how):"
"""What a run's summary says of a camera that was left out; its name follows."""

MOVED = "evidence: pixels whose z contradicts the proxy; the proxy was taken (check scale and units of both):"
"""What a run's summary says of them."""

MOST_MOVED = 0.05
"""Share of the subject's pixels beyond which that is said: a coarse proxy differs at some edges."""


def measure_materials(space: Workspace[MeasureTask]) -> None:
    """Commits the materials of a frame as its cameras measure them, and the number of cameras of each pixel."""
    from yesnt.decompose.evidence.frame import measure_frame
    from yesnt.relight import ProxyScene
    from yesnt.tasks import relight_inputs
    from yesnt.tasks.evidence_inputs import evidence_inputs

    job, frame, camera = space.job, space.frame, space.camera()
    mean, spread = (space.read(DECOMPOSE, name, frame) for name in ("observed", "spread"))
    if not space.task.cameras:
        commit_evidence(space, FrameEvidence(mean, spread, np.zeros(mean.shape[1:], np.float32), {}, {}))
        return
    plate, seen = space.plate(frame, working=True), space.surface(frame, camera)
    views, mesh = captured_views(space), space.inputs.proxy()
    settings = of.relight_settings(job.shot)
    with space.kernel():
        proxy = relight_inputs.proxy_scene(mesh, ProxyScene)
        bare = relight_inputs.RelightInputs(plate, seen, camera, frame, proxy)
        inputs = evidence_inputs(bare, (mean, spread), views, LightFiles(job, frame, space.node.inputs), settings)
        found = measure_frame(inputs, settings, of.evidence_settings(job.shot))
    commit_evidence(space, found)


def commit_evidence(space: Workspace[MeasureTask] | Workspace[TrackTask], found: FrameEvidence) -> None:
    """Commits what was measured in a frame, with the facts that reports and summaries show."""
    matte = space.matte(space.frame)
    shown = float(found.views[matte].mean()) if matte.any() else 0.0
    without = {f"{WITHOUT} {name}": int(matte.sum()) for name in found.left_out}
    facts = {
        "left_out": found.left_out, "gains": found.gains, "views": shown, "light": list(found.light),
        "moved": found.moved,
    }  # fmt: skip
    if found.moved > MOST_MOVED * matte.sum():
        without[MOVED] = found.moved
    space.commit(space.frame, _channels(found), facts=facts | ({"clamped": without} if without else {}))


def carry_materials(space: Workspace[CarryEvidenceTask]) -> None:
    """Commits a later frame's measured materials along the flow; elsewhere those of pixels that look alike."""
    from yesnt.decompose.evidence.carry import carried_evidence

    job, frame, keyframe = space.job, space.frame, space.task.keyframe
    way = job.frames[job.position(frame) : job.position(keyframe)]
    links = [Link(space.read(FLOW, "flow", f).transpose(1, 2, 0), space.read(FLOW, "validity", f)[0]) for f in way]
    mattes = [space.matte(f) for f in (*way, keyframe)]
    own = space.read(DECOMPOSE, "observed", frame), space.read(DECOMPOSE, "spread", frame)
    mean, spread, views = (space.read(EVIDENCE, name, keyframe) for name in ("measured", "measured_spread", "views"))
    plate, settings = space.plate(frame).color, of.evidence_settings(job.shot)
    with space.kernel():
        measured, reuse = FrameEvidence(mean, spread, views[0], {}, {}), of.ensemble_settings(job.shot)
        found = carried_evidence(measured, own, (links, mattes), reuse, plate, settings)
    matte = mattes[0]
    shown = float(found.views[matte].mean()) if matte.any() else 0.0
    space.commit(frame, _channels(found), facts={"views": shown})


def _channels(found: FrameEvidence) -> dict[str, F32]:
    base = np.zeros((*found.views.shape, 4), np.float32) if found.base_views is None else found.base_views
    planes = {"measured": found.mean, "measured_spread": found.std, "views": found.views[None]}
    return planes | {"base_views": np.ascontiguousarray(base.transpose(2, 0, 1))}
