"""Task that corrects the observed materials of one frame."""

from __future__ import annotations

from yesnt.planning.task_records import CorrectTask
from yesnt.tasks.observations import estimate
from yesnt.tasks.workspace import Workspace


def correct_materials(space: Workspace[CorrectTask]) -> None:
    """Commits the corrected materials, their spread and the share that is given, [2, H, W] each."""
    from yesnt.decompose.corrections import correct

    frame = space.frame
    matte = space.plate(frame).matte
    mean, spread = estimate(space, frame)
    overrides, facts = space.inputs.overrides(matte)
    with space.kernel():
        found = correct(mean, spread, overrides)
    channels = {"corrected": found.mean, "corrected_spread": found.spread, "certain": found.certain}
    space.commit(frame, channels, facts={"clamped": found.clamped + facts.clamped})
