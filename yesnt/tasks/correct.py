"""Task that corrects the observed materials of one frame."""

from __future__ import annotations

from yesnt.planning.task_records import CorrectTask
from yesnt.tasks.observations import estimate
from yesnt.tasks.workspace import Workspace

SCALED_BEYOND = "materials: values that a scale takes above 1, set to 1"


def correct_materials(space: Workspace[CorrectTask]) -> None:
    """Commits the corrected materials, their spread and the share that is given, [2, H, W] each."""
    from yesnt.decompose.corrections import correct

    frame = space.frame
    matte = space.plate(frame).matte
    mean, spread = estimate(space, frame)
    overrides = space.inputs.overrides(matte)
    with space.kernel():
        found = correct(mean, spread, overrides)
    channels = {"corrected": found.mean, "corrected_spread": found.spread, "certain": found.certain}
    space.commit(frame, channels, facts={"clamped": {SCALED_BEYOND: found.clamped}} if found.clamped else {})
