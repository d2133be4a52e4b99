"""Commit records: a frame of a stage is done when its record exists and holds the key that the job asks for."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from yesnt.core.fault_points import fault_point
from yesnt.io.durable import retried, write_json


@dataclass(frozen=True)
class Record:
    """What a finished frame of a stage leaves behind.

    Attributes:
        stage: stage name.
        frame: frame number as delivered.
        key: `key_of(fields)`.
        fields: everything that the result depends on; `explain` compares them.
        arrays: array name -> digest of the decoded frame.
        files: path relative to the output folder -> digest of the file's bytes.
        seconds: time in the task, and in its kernel.
        facts: small numbers for reports (peak memory, iterations, patches, thread counts).
    """

    stage: str
    frame: int
    key: str
    fields: Mapping[str, Any]
    arrays: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


def key_of(fields: Mapping[str, Any]) -> str:
    """BLAKE2b-128 of the canonical JSON of what a result depends on."""
    text = json.dumps(fields, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


class RecordBook:
    """All records of one output folder, a small file each, written whole or not at all.

    Args:
        folder: `out/run/records`.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def path(self, stage: str, frame: int) -> Path:
        """Where a record lies."""
        return self.folder / stage / f"{frame:04d}.json"

    def commit(self, record: Record) -> None:
        """Makes a frame done. Its arrays and files must be on disk before."""
        path = self.path(record.stage, record.frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        fault_point("record.before_commit")
        write_json(path, asdict(record))
        fault_point("record.after_commit")

    def find(self, stage: str, frame: int) -> Record | None:
        """The record of a frame, or None if there is none that can be read (then the frame is simply not done)."""
        try:
            document = json.loads(retried(self.path(stage, frame).read_text))
            return Record(**document)
        except (OSError, ValueError, TypeError):
            return None

    def done(self, stage: str, frame: int, key: str) -> Record | None:
        """The record of a frame if it holds this key."""
        record = self.find(stage, frame)
        return record if record is not None and record.key == key else None

    def forget(self, stage: str, frame: int) -> None:
        """Makes a frame not done."""
        self.path(stage, frame).unlink(missing_ok=True)
