"""Task of the optical flow."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from yesnt.io.jobfile import frame_path
from yesnt.planning import settings as of
from yesnt.planning.task_records import FlowTask
from yesnt.tasks.inputs import read_checked
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.temporal.flow import Matcher


def estimate_flow(space: Workspace[FlowTask]) -> None:
    """Commits the flow of one frame to the next, [2, H, W] in pixels, and its validity, [1, H, W] in [0, 1]."""
    from yesnt.temporal import vertical_reach
    from yesnt.temporal.flow import flow_and_validity, flow_validity

    job, frame = space.job, space.frame
    now, then = space.plate(frame), space.plate(job.frames[job.position(frame) + 1])
    settings = of.flow_settings(job.shot)
    if job.shot.flow.path is not None:
        vectors = space.inputs.flow()
        with space.kernel():
            inside = now.matte > 0.5, then.matte > 0.5
            validity = flow_validity(vectors, None, now.color, then.color, *inside, settings)
    else:
        with space.kernel():
            match = _matcher(space)
            vectors, validity = flow_and_validity(now.color, then.color, now.matte, then.matte, settings, match)
    with space.kernel():
        facts = {"reach": min(vertical_reach(vectors, validity * (now.matte > 0.5)), job.height)}
    space.commit(frame, {"flow": vectors.transpose(2, 0, 1), "validity": validity[None]}, facts=facts)


def _matcher(space: Workspace[FlowTask]) -> Matcher | None:
    """The learned flow that the job names, or None."""
    weights = space.job.shot.flow.weights
    if weights is None:
        return None
    return _spynet(frame_path(space.job.root, weights, 0), space.node.inputs["weights"])


@lru_cache(maxsize=1)
def _spynet(path: Path, digest: str) -> Matcher:
    """The network of these weights; it stays in the worker."""
    from yesnt.decompose.threads import one_thread
    from yesnt.temporal.spynet import open_spynet

    return one_thread()(read_checked(path, digest, lambda: open_spynet(path)).__call__)
