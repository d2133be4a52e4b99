"""Checks of the artist's corrections before a run: names that no frame knows, masks that meet nothing, odd values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.shot import Job, Shot
from yesnt.io.corrections import read_overrides
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.cryptomattes import unknown_name


def corrections_of(shot: Shot) -> list[Any]:
    """All that a job says of corrections, as JSON values: what the checks of a frame depend on."""
    quantities = {name: one.model_dump(mode="json") for name, one in shot.decompose.quantities.items()}
    return [quantities, [one.model_dump(mode="json") for one in shot.materials]]


def correction_facts(job: Job, frame: int, matte: NDArray[np.float32]) -> dict[str, Any]:
    """What the corrections of a frame meet, as JSON values.

    Raises:
        JobError: a mask, a Cryptomatte or a pass cannot be used.
    """
    facts = read_overrides(job, frame, matte)[1]
    known = [names if absent else () for names, absent in zip(facts.known, facts.absent, strict=True)]
    return {
        "touched": facts.touched, "absent": [*map(list, facts.absent)], "known": [*map(list, known)],
        "clamped": facts.clamped,
    }  # fmt: skip


class CorrectionChecks:
    """Adds up what the corrections meet in all frames.

    Args:
        job: the job.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        entries = range(len(job.shot.materials))
        self._touched = [0 for _ in entries]
        self._absent: list[set[str] | None] = [None for _ in entries]
        self._known: list[set[str]] = [set() for _ in entries]
        self._clamped = 0

    def add(self, fact: Mapping[str, Any] | None) -> None:
        """Adds a frame's facts; None: the job corrects nothing."""
        if fact is None:
            return
        self._clamped += fact["clamped"]
        for number, touched in enumerate(fact["touched"]):
            absent, before = set(fact["absent"][number]), self._absent[number]
            self._touched[number] += touched
            self._absent[number] = absent if before is None else absent & before
            self._known[number] |= set(fact["known"][number])

    def warnings(self) -> list[str]:
        """What is odd and used nevertheless.

        Raises:
            JobError: a name is in no frame.
        """
        for number, absent in enumerate(self._absent):
            for name in sorted(absent or ()):
                raise unknown_name(name, self._known[number], self._path(number), f"materials.{number}")
        found = [
            f"materials.{number}: {self._path(number)} covers no pixel of the matte in any frame"
            for number, touched in enumerate(self._touched) if not touched
        ]  # fmt: skip
        if self._clamped:
            found.append(f"corrections: values outside [0, 1] that are set to its ends: {self._clamped} in the shot")
        return found

    def _path(self, number: int) -> str:
        return str(frame_path(self._job.root, self._job.shot.materials[number].path, self._job.frames[0]))
