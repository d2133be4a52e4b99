"""Why a frame would be computed again."""

from __future__ import annotations

from yesnt.core.errors import UsageError
from yesnt.inspect.frame_states import FrameState, states
from yesnt.runtime.session import Session


def explain(session: Session, frame: int) -> list[FrameState]:
    """The states of one frame through all stages.

    Raises:
        UsageError: the shot has no such frame.
    """
    if frame not in session.job.all_but():
        raise UsageError(
            f"The shot has no frame {frame}", "explain FRAME", session.job.shot.frames, "choose among these"
        )
    return [state for state in states(session) if state.frame == frame]
