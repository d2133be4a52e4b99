"""Tasks of the decomposition: passes of the job, one frame sampled, a window of frames sampled, windows blended."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.job_part import Knob
from yesnt.decompose.identity import identify_backend
from yesnt.decompose.registry import find_weights, open_backend
from yesnt.decompose.reuse import Link, Prior, propagate_keyframe
from yesnt.decompose.window import blend, estimate_clip, make_clip
from yesnt.planning import settings as of
from yesnt.planning.stages import DECOMPOSE, FLOW
from yesnt.planning.task_records import BlendWindowsTask, DecomposeTask, ReadPassesTask, WindowTask
from yesnt.tasks.inputs import input_changed
from yesnt.tasks.workspace import Workspace

Float32 = NDArray[np.float32]


def read_passes(space: Workspace[ReadPassesTask]) -> None:
    """Commits the materials and their spread, [2, H, W] each, from the passes that the job brings."""
    mean, spread = space.inputs.passes()
    space.commit(space.frame, {"observed": mean, "spread": spread})


def sample_frame(space: Workspace[DecomposeTask]) -> None:
    """Commits mean and spread of one frame's materials, [2, H, W] each, and the network evaluations, [1, H, W]."""
    from yesnt.decompose.ensemble import estimate_frame

    job, frame = space.job, space.frame
    plate = space.plate(frame)
    backend = _chosen_backend(space)
    settings, prior = of.ensemble_settings(job.shot), _carried(space, plate.matte)
    with space.kernel():
        estimate = estimate_frame(plate.color, plate.matte, backend, settings, job.shot.seed, frame, prior)
    channels = {"observed": estimate.mean, "spread": estimate.std, "nfe": estimate.nfe[None]}
    space.commit(frame, channels, facts={"nfe": estimate.total_nfe})


def sample_window(space: Workspace[WindowTask]) -> None:
    """Commits mean and spread of every frame of one window, sampled together by a video backend."""
    job, frames = space.job, space.node.frames
    plates = [space.plate(frame) for frame in frames]
    backend = _chosen_backend(space)
    clip = make_clip([p.color for p in plates], [p.matte for p in plates], frames, backend.footprint.window)
    with space.kernel():
        estimate = estimate_clip(clip, backend, of.ensemble_settings(job.shot), job.shot.seed)
    for i, frame in enumerate(frames):
        channels = {"observed": estimate.mean[i], "spread": estimate.std[i]}
        space.commit(frame, channels, facts={"members": estimate.members})


def blend_windows(space: Workspace[BlendWindowsTask]) -> None:
    """Commits a frame as the mixture of the windows that cover it; their cost is divided among their frames."""
    frame, weights = space.frame, space.task.weights
    matte = space.plate(frame).matte
    means, stds = ([space.read(stage, name, frame) for stage in weights] for name in ("observed", "spread"))
    with space.kernel():
        mean, std = blend(means, stds, list(weights.values()))
    records = [space.book.find(stage, frame) for stage in weights]
    spent = sum(r.facts["members"] for r in records if r is not None) * space.task.nfe
    nfe = np.where(matte > 0, np.float32(spent), np.float32(0))[None]
    space.commit(frame, {"observed": mean, "spread": std, "nfe": nfe}, facts={"nfe": spent})


def _chosen_backend(space: Workspace[DecomposeTask] | Workspace[WindowTask]) -> Any:
    """The backend that the job names, with the weights of the task's digest; it stays in the worker."""
    job, chosen = space.job, space.job.shot.decompose
    knobs = tuple(sorted(of.backend_knobs(job.shot).items()))
    weights = of.weights_path(job.root, job.shot)
    return _backend(chosen.backend, weights, space.task.weights, chosen.accept_license, knobs)


def _carried(space: Workspace[DecomposeTask], matte: Float32) -> Prior | None:
    """A keyframe's estimate along the flow to this frame; None for a keyframe."""
    job, frame, keyframe = space.job, space.frame, space.task.keyframe
    if keyframe is None:
        return None
    way = job.frames[job.position(frame) : job.position(keyframe)]
    links = [Link(space.read(FLOW, "flow", f).transpose(1, 2, 0), space.read(FLOW, "validity", f)[0]) for f in way]
    mattes = [matte > 0.5, *(space.matte(f) for f in (*way[1:], keyframe))]
    mean, spread = (space.read(DECOMPOSE, name, keyframe) for name in ("observed", "spread"))
    with space.kernel():
        return propagate_keyframe(mean, spread, links, mattes, of.ensemble_settings(job.shot))


@lru_cache(maxsize=1)
def _backend(
    name: str, weights: Path | None, digest: str, accepted: tuple[str, ...], knobs: tuple[tuple[str, Knob], ...]
) -> Any:
    """Loading a model costs more than a frame, so the last one is kept.

    Raises:
        JobError: the weights are not those of this digest: they were replaced while the job runs.
    """
    backend = open_backend(name, weights, accepted, dict(knobs))
    if identify_backend(name, weights, accepted, dict(knobs)).weights != digest:
        raise input_changed(find_weights(name, weights))
    return backend
