"""Identifies a pipeline stage, or one part of a stage whose result is stored under a name of its own."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

_LABEL = re.compile(
    r"(?P<name>[^.]+)(?:\.sweep(?P<sweep>\d+))?(?:\.band(?P<band>\d+))?(?:\.lane(?P<lane>\d+))?(?:\.(?P<part>.+))?"
)


@dataclass(frozen=True)
class StageId:
    """A stage of the pipeline and, where it stores intermediate results, which of them.

    Attributes:
        name: row of the stage table (`planning/stages.py`), or a stage of the evaluation.
        sweep: exchange sweep of the temporal solver; None for the final material.
        band: band of rows that was solved separately; None for whole frames.
        lane: sequence of windows of a video backend that do not overlap.
        part: another named part: a video segment of the preview, a light map of the evaluation.
    """

    name: str
    sweep: int | None = None
    band: int | None = None
    lane: int | None = None
    part: str = ""

    @cached_property
    def label(self) -> str:
        """Name in paths, logs and events: `solve`, `solve.sweep0.band3`, `window.lane1`, `preview.segment`."""
        numbers = (("sweep", self.sweep), ("band", self.band), ("lane", self.lane))
        parts = [self.name, *(f"{word}{number}" for word, number in numbers if number is not None)]
        return ".".join([*parts, self.part] if self.part else parts)

    def array(self, channel: str) -> str:
        """Name of the frame store's array that holds a channel of this stage."""
        return channel if self.label == self.name else f"{self.label}.{channel}"

    @classmethod
    def parse(cls, label: str) -> StageId:
        """The identifier of a label that was read from a record, an event or the command line.

        Raises:
            ValueError: the text is no label.
        """
        found = _LABEL.fullmatch(label)
        if found is None:
            raise ValueError(f"{label!r} is no label of a stage")
        numbers = {word: None if found[word] is None else int(found[word]) for word in ("sweep", "band", "lane")}
        return cls(found["name"], **numbers, part=found["part"] or "")

    def __str__(self) -> str:
        return self.label

    def __hash__(self) -> int:
        return hash(self.label)  # a string keeps its hash, a tuple of fields does not
