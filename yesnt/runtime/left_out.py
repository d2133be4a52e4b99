"""Frames that a run leaves out since their mattes, fields or views could not be made, and what it remembers of them.

All other frames go on as in a job without these frames.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io.durable import write_json
from yesnt.io.record_index import RecordIndex
from yesnt.planning.builders.gaussians import gaussian_nodes
from yesnt.planning.builders.matte import matte_nodes
from yesnt.planning.shot_plan import MATTES, Awaiting, ShotPlan
from yesnt.runtime.awaited import MAKERS
from yesnt.runtime.driver.driver import is_done


@dataclass(frozen=True)
class Missing:
    """Frames that could not be made: (stage, frame) -> reason."""

    reasons: Mapping[tuple[StageId, int], str]

    def frames(self, *stages: str) -> frozenset[int]:
        """Frames missing from any of these stages."""
        return frozenset(frame for stage, frame in self.reasons if stage.name in stages)


NOTHING_MISSING = Missing({})


@dataclass(frozen=True)
class LeftOut:
    """Frames that are left out.

    Attributes:
        stages: frame -> the stage that could not make what the frame is read from.
        reasons: frame -> why.
    """

    stages: Mapping[int, str] = field(default_factory=dict)
    reasons: Mapping[int, str] = field(default_factory=dict)

    def of(self, frames: Iterable[int]) -> dict[int, str]:
        """The stages of those among some frames; empty if none of the frames would be left."""
        frames = set(frames)
        found = {frame: stage for frame, stage in self.stages.items() if frame in frames}
        return found if len(found) < len(frames) else {}

    def write(self, run: Path) -> None:
        """Keeps what the last run left out, for verbs that look at its results; without frames nothing is kept."""
        if not self.stages:
            left_out_path(run).unlink(missing_ok=True)
            return
        rows = [{"frame": f, "stage": stage, "reason": self.reasons[f]} for f, stage in sorted(self.stages.items())]
        write_json(left_out_path(run), rows)

    @classmethod
    def read(cls, run: Path) -> LeftOut:
        """What the last run left out; nothing if there is no note, or one that cannot be read."""
        try:
            rows = json.loads(left_out_path(run).read_text())
            stages = {int(row["frame"]): str(row["stage"]) for row in rows}
            return cls(stages, {int(row["frame"]): str(row["reason"]) for row in rows})
        except (OSError, ValueError, KeyError, TypeError):
            return cls()


def left_out_path(run: Path) -> Path:
    """The note, in the run folder."""
    return run / "left_out.json"


def left_out(job: Job, awaiting: Awaiting, plan: ShotPlan, missing: Missing, index: RecordIndex) -> LeftOut:
    """Frames whose mattes, fields or views are not there after a run has done what it could.

    Args:
        job: with the frames that were left out before.
        awaiting: what was to be made.
        plan: of what was made, without what failed.
        missing: what could not be made.
        index: of the records.
    """
    stages = dict(job.left_out)
    reasons = dict.fromkeys(stages, "")
    failed = {(stage.name, frame): why for (stage, frame), why in missing.reasons.items()}
    for name in MAKERS:  # in their order: what failed first is the cause
        for frame in (frame for frame in job.all_but() if (name, frame) in failed):
            stages.setdefault(frame, name)
            reasons[frame] = reasons.get(frame) or failed[name, frame]
    nodes = matte_nodes(plan) if awaiting == MATTES else gaussian_nodes(plan)
    frames = set(job.frames)
    for node in nodes:
        if frames.issuperset(node.frames) and not is_done(index, node):
            for frame in node.frames:
                stages.setdefault(frame, node.stage.name)
                reasons.setdefault(frame, "what it needs could not be made")
    return LeftOut(dict(sorted(stages.items())), reasons)


def frames_before_gaps(job: Job) -> frozenset[int]:
    """Frames whose precomputed flow leads to a frame that is left out: it says nothing of the next one that is not."""
    if job.shot.flow.path is None or not job.left_out:
        return frozenset()
    left, every = dict(job.left_out), job.all_but()
    return frozenset(one for one, then in pairwise(every) if then in left)
