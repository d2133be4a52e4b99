"""Makes frames not done, so that the next run computes them again."""

from __future__ import annotations

from yesnt.core.errors import UsageError
from yesnt.io.jobfile import parse_frames
from yesnt.planning.stages import STAGES
from yesnt.runtime.session import Session


def forget(session: Session, stages: list[str], frames: str | None) -> int:
    """Removes the records and the marks of death of some frames; returns how many were removed.

    Raises:
        UsageError: an unknown stage or frame range.
        JobError: a driver runs the job.
    """
    unknown = sorted(set(stages) - set(STAGES))
    if unknown:
        raise UsageError(f"No stage {unknown[0]!r}", "--stage", f"one of {', '.join(STAGES)}", "check its spelling")
    wanted = set(session.job.all_but() if frames is None else parse_frames(frames, "--frames"))
    with session.output.lock():
        return _forget_marks(session, stages, wanted) + _forget_records(session, stages, wanted)


def _forget_marks(session: Session, stages: list[str], wanted: set[int]) -> int:
    chosen = [(s, f) for s, f in session.marked_dead() if f in wanted and s.name in stages]
    for stage, frame in chosen:
        session.dead_marks.remove(stage, frame)
    return len(chosen)


def _forget_records(session: Session, stages: list[str], wanted: set[int]) -> int:
    nodes = [node for node in session.graph() if node.stage.name in stages]
    chosen = [(node.stage, frame) for node in nodes for frame in wanted.intersection(node.frames)]
    held = [(stage, frame) for stage, frame in chosen if session.book.find(stage, frame)]
    for stage, frame in held:
        session.book.forget(stage, frame)
    return len(held)
