"""Tasks of the decomposition: a frame drawn in full, one between keyframes, a window of frames, passes made before."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.shot import Knob
from yesnt.decompose.identity import identify_backend
from yesnt.decompose.registry import find_weights, open_backend
from yesnt.decompose.reuse import Link, Prior, propagate_keyframe
from yesnt.decompose.window import blend, estimate_clip, make_clip
from yesnt.planning import settings as of
from yesnt.tasks.inputs import input_changed
from yesnt.tasks.workspace import Workspace

Float32 = NDArray[np.float32]


def decompose(space: Workspace) -> None:
    """Mean and spread of the material of one frame."""
    job, frame = space.job, space.node.frames[0]
    if job.shot.decompose.path is not None:
        mean, spread = space.inputs.passes()
        space.commit(frame, {"observed": mean, "spread": spread})
        return
    if space.node.arguments["mix"]:
        _blend_windows(space)
        return
    from yesnt.decompose.ensemble import estimate_frame

    plate = space.plate(frame)
    backend = _chosen_backend(space)
    settings, prior = of.ensemble_settings(job.shot), _carried(space, plate.matte)
    with space.kernel():
        estimate = estimate_frame(plate.color, plate.matte, backend, settings, job.shot.seed, frame, prior)
    arrays = {"observed": estimate.mean, "spread": estimate.std, "evaluations": estimate.nfe[None]}
    space.commit(frame, arrays, facts={"evaluations": estimate.total_nfe})


def window(space: Workspace) -> None:
    """Mean and spread of the material of every frame of one window, drawn together by a video backend."""
    job, frames = space.job, space.node.frames
    plates = [space.plate(frame) for frame in frames]
    backend = _chosen_backend(space)
    clip = make_clip([p.color for p in plates], [p.matte for p in plates], frames, backend.footprint.window)
    with space.kernel():
        estimate = estimate_clip(clip, backend, of.ensemble_settings(job.shot), job.shot.seed)
    for i, frame in enumerate(frames):
        arrays = {f"{space.node.stage}.observed": estimate.mean[i], f"{space.node.stage}.spread": estimate.std[i]}
        space.commit(frame, arrays, facts={"members": estimate.members})


def _blend_windows(space: Workspace) -> None:
    """Commits a frame that windows have drawn; the cost of a window's member is spread over its frames."""
    frame, mix = space.node.frames[0], space.node.arguments["mix"]
    matte = space.plate(frame).matte
    means, stds = ([space.read(stage, f"{stage}.{name}", frame) for stage in mix] for name in ("observed", "spread"))
    with space.kernel():
        mean, std = blend(means, stds, list(mix.values()))
    records = [space.book.find(stage, frame) for stage in mix]
    spent = sum(r.facts["members"] for r in records if r is not None) * space.node.arguments["cost"]
    evaluations = np.where(matte > 0, np.float32(spent), np.float32(0))[None]
    arrays = {"observed": mean, "spread": std, "evaluations": evaluations}
    space.commit(frame, arrays, facts={"evaluations": spent})


def _chosen_backend(space: Workspace) -> Any:
    """The backend that the job names, with the weights that the node's key holds; it stays in the worker."""
    job, chosen = space.job, space.job.shot.decompose
    knobs = tuple(sorted(of.backend_knobs(job.shot).items()))
    digest: str = space.node.fields["settings"]["backend"]["weights"]
    return _backend(chosen.backend, of.weights_path(job.root, job.shot), digest, chosen.accept_license, knobs)


def _carried(space: Workspace, matte: Float32) -> Prior | None:
    """A keyframe's estimate along the flow to this frame; None for a keyframe."""
    job, frame, keyframe = space.job, space.node.frames[0], space.node.arguments["keyframe"]
    if keyframe is None:
        return None
    way = job.frames[job.position(frame) : job.position(keyframe)]
    links = [Link(space.read("flow", "flow", f).transpose(1, 2, 0), space.read("flow", "validity", f)[0]) for f in way]
    mattes = [matte > 0.5, *(space.matte(f) for f in (*way[1:], keyframe))]
    mean, spread = (space.read("decompose", name, keyframe) for name in ("observed", "spread"))
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
