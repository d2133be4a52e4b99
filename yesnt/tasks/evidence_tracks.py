"""Task of the evidence over time: one frame measured by other frames of the same camera, along the flow."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.records import FrameEvidence
from yesnt.planning import settings as of
from yesnt.planning.stages import DECOMPOSE, FLOW
from yesnt.planning.task_records import TrackTask
from yesnt.tasks.evidence import commit_evidence
from yesnt.tasks.light import LightFiles
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]


def measure_tracks(space: Workspace[TrackTask]) -> None:
    """Commits the materials of a frame as the frames around it measure them, and how many frames show each pixel."""
    from yesnt.decompose.evidence.over_time import Moment, measure_over_time
    from yesnt.relight import ProxyScene
    from yesnt.tasks import relight_inputs
    from yesnt.tasks.evidence_inputs import evidence_inputs

    job, frame, camera = space.job, space.frame, space.camera()
    mean, spread = (space.read(DECOMPOSE, name, frame) for name in ("observed", "spread"))
    if not space.task.moments:
        commit_evidence(space, FrameEvidence(mean, spread, np.zeros(mean.shape[1:], np.float32), {}, {}))
        return
    settings = of.relight_settings(job.shot)
    bare = partial(relight_inputs.RelightInputs, camera=camera)
    read = {
        one: (space.plate(one, working=True), space.surface(one, camera), space.inputs.proxy(one))
        for one in (frame, *space.task.moments)
    }
    places = {one: _places(space, one) for one in space.task.moments}
    with space.kernel():
        inputs = {}
        for one, (plate, seen, mesh) in read.items():
            shown = bare(plate, seen, frame=one, proxy=relight_inputs.proxy_scene(mesh, ProxyScene))
            # Of other frames only the geometry is asked for: any materials will do.
            inputs[one] = evidence_inputs(shown, (mean, spread), [], _lights(space, one), settings)
        moments = [Moment(inputs[one], places[one]) for one in space.task.moments]
        found = measure_over_time(inputs[frame], moments, settings, of.evidence_settings(job.shot))
    commit_evidence(space, found)


def _lights(space: Workspace[TrackTask], frame: int) -> LightFiles:
    """Digests of the light's files in a frame, by the roles that they have there."""
    known, suffix = space.node.inputs, "" if frame == space.frame else f" {frame}"
    capture = {"capture": known[f"capture{suffix}"]} if f"capture{suffix}" in known else {}
    return LightFiles(space.job, frame, {**known, **capture})


def _places(space: Workspace[TrackTask], other: int) -> F32:
    """Where the pixels of the node's frame are in another, [H, W, 2]."""
    from yesnt.decompose.evidence.tracks import earlier_places, later_places
    from yesnt.decompose.reuse import Link

    job, frame = space.job, space.frame
    frames = job.frames[job.position(min(frame, other)) : job.position(max(frame, other)) + 1]
    links = []
    for one in frames[:-1]:
        flow, validity = (space.read(FLOW, name, one) for name in ("flow", "validity"))
        links.append(Link(flow.transpose(1, 2, 0), validity[0]))
    mattes = [space.matte(f) for f in frames]
    with space.kernel():
        return later_places(links, mattes) if other > frame else earlier_places(links, mattes)
