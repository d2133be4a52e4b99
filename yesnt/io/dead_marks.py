"""Marks of frames that are left out: they killed their workers, or the user skipped them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from yesnt.core.stage_id import StageId
from yesnt.io.durable import write_json

SKIPPED = "skipped"
"""How the reason of a mark begins that the user set."""

Marks = dict[tuple[StageId, int], str]


class DeadMarks:
    """A small file per frame of a stage, with the reason; `yesnt retry` takes it away.

    Args:
        folder: `out/run/dead`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def read(self) -> Marks:
        """(stage, frame) -> reason. A mark that cannot be read counts: its frame may kill workers."""
        marks: Marks = {}
        for path in sorted(self._folder.glob("*/*.json")):
            try:
                document = json.loads(path.read_text())
                marks[StageId.parse(document["stage"]), document["frame"]] = document["reason"]
            except (ValueError, KeyError, TypeError):
                marks[StageId.parse(path.parent.name), int(path.stem)] = "its mark is damaged"
        return marks

    def set(self, stage: StageId, frames: Iterable[int], reason: str) -> None:
        """Marks frames of a stage."""
        for frame in frames:
            path = self._path(stage, frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, {"stage": stage.label, "frame": frame, "reason": reason})

    def remove(self, stage: StageId, frame: int) -> None:
        """Takes a mark away."""
        self._path(stage, frame).unlink(missing_ok=True)

    def _path(self, stage: StageId, frame: int) -> Path:
        return self._folder / stage.label / f"{frame:04d}.json"
