"""`yesnt status`: what is done of a shot, each cause stated once, frames as ranges."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from yesnt.core.frame_ranges import frame_ranges
from yesnt.core.job_progress import Progress, no_progress
from yesnt.inspect.status_memory import StatusMemory

KINDS = ("done", "stale", "waiting", "dead")


@dataclass(frozen=True)
class StateGroup:
    """Frames of a stage that are in one state for the same causes.

    Attributes:
        stage: label of the stage.
        state: one of `KINDS`.
        frames: frame numbers as ranges, `1001-1016`.
        causes: why they are not done, in words.
        follows: stages whose new results they take.
    """

    stage: str
    state: str
    frames: str
    causes: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()


@dataclass(frozen=True)
class StatusReport:
    """State of a whole shot.

    Attributes:
        counts: stage -> state -> number of frames, in stage order.
        groups: every frame of every stage, those alike together.
    """

    counts: dict[str, dict[str, int]]
    groups: tuple[StateGroup, ...]

    def as_json(self) -> dict[str, Any]:
        """A plain document: complete, since ranges name every frame."""
        return {
            "stages": [{"stage": stage, **counts} for stage, counts in self.counts.items()],
            "states": [asdict(group) for group in self.groups],
        }

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> StatusReport:
        """The report of a document of `as_json`."""
        counts = {row["stage"]: {kind: row[kind] for kind in KINDS} for row in document["stages"]}
        groups = (
            StateGroup(g["stage"], g["state"], g["frames"], tuple(g["causes"]), tuple(g["follows"]))
            for g in document["states"]
        )
        return cls(counts, tuple(groups))


def status(path: str | Path, progress: Progress = no_progress) -> StatusReport:
    """State of the shot of a job file or its folder.

    Where nothing has changed since the last call, its answer is returned: that takes a look at times and sizes only.

    Raises:
        JobError: the job file is wrong, or an input is missing.
    """
    memory = StatusMemory.of(Path(path))
    remembered = memory.recall()
    if remembered is not None:
        return StatusReport.from_json(remembered)
    from yesnt.inspect.frame_states import states
    from yesnt.runtime.left_out import left_out_path
    from yesnt.runtime.session import Session

    session = Session(path, progress=progress, as_run=True)
    index = session.open_index()
    report = summarize(states(session, index=index))
    index.save()
    note = str(left_out_path(session.output.run))
    memory.keep(report.as_json(), [note, *session.resolved.files, *index.files(session.output.root)])
    return report


def summarize(found: Iterable[Any]) -> StatusReport:
    """Groups frame states (`FrameState`) that are alike."""
    counts: dict[str, Counter[str]] = {}
    alike: dict[tuple[str, str, tuple[str, ...], tuple[str, ...]], list[int]] = {}
    for one in found:
        counts.setdefault(one.stage, Counter())[one.state] += 1
        alike.setdefault((one.stage, one.state, one.causes, one.follows), []).append(one.frame)
    groups = (StateGroup(key[0], key[1], frame_ranges(frames), *key[2:]) for key, frames in alike.items())
    return StatusReport({stage: {kind: n[kind] for kind in KINDS} for stage, n in counts.items()}, tuple(groups))
