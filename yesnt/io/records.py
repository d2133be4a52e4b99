"""Commit records: a frame of a stage is done when its record exists and holds the key that the job asks for."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from yesnt.core.fault_points import fault_point
from yesnt.core.stage_id import StageId
from yesnt.io.durable import retried, write_bytes
from yesnt.io.file_digests import file_digest

FileState = tuple[int, int]
"""Size of a file in bytes and time of its last change in nanoseconds."""


@dataclass(frozen=True)
class Record:
    """What a finished frame of a stage leaves behind.

    Attributes:
        stage: label of the stage (`StageId.label`).
        frame: frame number as delivered.
        key: `key_of(fields)`.
        fields: everything that the result depends on; `explain` compares them.
        arrays: array name -> digest of the decoded frame.
        files: path relative to the output folder -> digest of the file's bytes.
        seconds: time in the task, and in its kernel.
        facts: small numbers for reports (peak memory, iterations, patches, thread counts).
        file_states: the paths of `files` -> size in bytes and time of the last change in nanoseconds at the commit.
        check: digest of the record's own text, so that a damaged record is never believed; "" in older records.
    """

    stage: str
    frame: int
    key: str
    fields: Mapping[str, Any]
    arrays: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    file_states: Mapping[str, FileState] = field(default_factory=dict)
    check: str = ""


def digest_of(document: Any) -> str:
    """BLAKE2b-128 of the canonical JSON of a document, hexadecimal.

    Raises:
        ValueError: a number is not finite.
    """
    return _hash(json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False))


def digest_of_keys(keys: Iterable[str]) -> str:
    """Digest of many keys, in order."""
    return _hash(" ".join(keys))


def _hash(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


class SharedSettings(dict[str, Any]):
    """Settings that many tasks have in common; their digest is computed once. Not to be changed."""

    @cached_property
    def digest(self) -> str:
        """Digest of the settings."""
        return digest_of(self)


def key_of(fields: Mapping[str, Any]) -> str:
    """Key of a commit record: a hash of everything that its result depends on.

    `settings` enter by their own digest, since thousands of tasks share them. A task that commits several frames has
    one set of fields for all; the field `frame` then enters last (`frame_key`).

    Raises:
        ValueError: a number is not finite.
    """
    own = {name: value for name, value in fields.items() if name != "frame"}
    if "settings" in own:
        settings = own["settings"]
        own["settings"] = settings.digest if isinstance(settings, SharedSettings) else digest_of(settings)
    key = digest_of(own)
    return frame_key(key, fields["frame"]) if "frame" in fields else key


def frame_key(key: str, frame: int) -> str:
    """Key of one frame of a task that commits several."""
    return _hash(f"{key} {frame}")


class RecordBook:
    """All records of one output folder, a small file each, written whole or not at all.

    Args:
        folder: `out/run/records`.
        root: the output folder, which the paths in records are relative to; with it, a frame is done only while its
            files are there as they were committed.
    """

    def __init__(self, folder: str | Path, root: Path | None = None) -> None:
        self.folder, self._root = Path(folder), root

    def path(self, stage: StageId | str, frame: int) -> Path:
        """Where a record lies; the stage by its identifier or its label."""
        return self.folder / str(stage) / f"{frame:04d}.json"

    def commit(self, record: Record) -> None:
        """Makes a frame done. Its arrays and files must be on disk before."""
        path = self.path(record.stage, record.frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        fault_point("record.before_commit")
        write_bytes(path, _text_of(record).encode())
        fault_point("record.after_commit")

    def find(self, stage: StageId | str, frame: int) -> Record | None:
        """The record of a frame, or None if there is none that can be read (then the frame is simply not done)."""
        try:
            text = retried(self.path(stage, frame).read_text)
            record = Record(**json.loads(text))
        except (OSError, ValueError, TypeError):
            return None
        if (record.stage, record.frame) != (str(stage), frame):
            return None  # another frame's record lies here
        return record if not record.check or _check_of(text, record.check) == record.check else None

    def done(self, stage: StageId | str, frame: int, key: str) -> Record | None:
        """The record of a frame if it holds this key and the frame's files are those that were committed."""
        record = self.find(stage, frame)
        return record if record is not None and record.key == key and not self.damage(record) else None

    def damage(self, record: Record) -> str:
        """What is wrong with a record's files, in words; "" if nothing is.

        Size and time are always compared, the content only where these differ: `verify` finds the rest.
        """
        if self._root is None:
            return ""
        for name, digest in record.files.items():
            state = record.file_states.get(name)
            found, _ = self.check_file(name, digest, None if state is None else (state[0], state[1]))
            if found:
                return found
        return ""

    def check_file(self, name: str, digest: str, state: FileState | None) -> tuple[str, FileState | None]:
        """Compares a committed file with its record.

        Args:
            name: path relative to the output folder.
            digest: of the content that was committed.
            state: size and time of change with which it was committed; None if they are not known.

        Returns:
            what is wrong, in words ("" if nothing is), and the file's size and time of change.
        """
        if self._root is None:
            return "", None
        try:
            now = file_state(self._root / name)
        except OSError:
            return f"{name} is missing", None
        if now != state and (not (self._root / name).is_file() or file_digest(self._root / name) != digest):
            return f"{name} is not the file that was committed", now
        return "", now

    def forget(self, stage: StageId | str, frame: int) -> None:
        """Makes a frame not done."""
        self.path(stage, frame).unlink(missing_ok=True)

    def keep_only(self, frames: Collection[int]) -> None:
        """Forgets the records of all other frames: the store has no place for frames outside the shot's range."""
        kept = frozenset(frames)
        for path in self.folder.glob("*/*.json"):
            if int(path.stem) not in kept:
                path.unlink(missing_ok=True)


_NO_CHECK = "0" * 32


def _text_of(record: Record) -> str:
    """JSON of a record, keys sorted, with its check."""
    text = json.dumps(vars(record) | {"check": _NO_CHECK}, sort_keys=True, indent=1) + "\n"
    place = f'"check": "{_NO_CHECK}"'
    return text.replace(place, f'"check": "{_hash(text)}"', 1)


def _check_of(text: str, check: str) -> str:
    """The check that a record's text should hold, given the one that it does hold."""
    return _hash(text.replace(f'"check": "{check}"', f'"check": "{_NO_CHECK}"', 1))


def file_state(path: Path) -> FileState:
    """Size and time of the last change of a file.

    Raises:
        OSError: it is missing.
    """
    found = path.stat()
    return found.st_size, found.st_mtime_ns
