"""Index of the commit records: what status and plan need of each, without reading tens of thousands of small files.

The index lies beside the records. An entry counts only while its record has the same size, time of change and inode, so
the file may be deleted at any time, and is ignored where it is damaged.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.io.file_digests import save_memory
from yesnt.io.records import FileState, Record, RecordBook

Signature = tuple[int, int, int]
"""Size, time of the last change in nanoseconds and inode of a record's file."""

_VERSION = 2


@dataclass(frozen=True)
class Entry:
    """What is kept of a record.

    Attributes:
        key: its key.
        fields: everything that its result depends on.
        seconds: time in the task.
        nfe: network evaluations that the frame took; None where the stage has none.
        files: path relative to the output folder -> digest.
        states: the same paths -> size and time of change with which the content was last checked.
        clamped: what was clamped -> how often.
    """

    key: str
    fields: Mapping[str, Any]
    seconds: float
    nfe: float | None
    files: dict[str, str]
    states: dict[str, FileState]
    clamped: Mapping[str, int]

    @classmethod
    def of(cls, record: Record) -> Entry:
        """The entry of a record."""
        seconds, nfe = record.seconds.get("task", 0.0), record.facts.get("nfe")
        files, states, clamped = dict(record.files), _states(record.file_states), record.facts.get("clamped", {})
        return cls(record.key, record.fields, seconds, nfe, files, states, clamped)


class RecordIndex:
    """Entries of all records of an output folder.

    Args:
        book: the records.
        memory: the index's file, `out/run/record_index.json`; it is written by `save` only.
    """

    def __init__(self, book: RecordBook, memory: Path) -> None:
        self._book, self._memory = book, memory
        self._known = _load(memory)
        self._changed = False
        self.look_again()

    def look_again(self) -> None:
        """Takes notice of records that were written, replaced or removed since."""
        self._found: dict[tuple[str, str], Signature] = dict(_scan(self._book.folder))
        self._changed = self._changed or self._known.keys() != self._found.keys()

    def find(self, stage: object, frame: int) -> Entry | None:
        """The entry of a frame; None if it has no record that can be read."""
        at = (str(stage), f"{frame:04d}.json")
        signature = self._found.get(at)
        if signature is None:
            return None
        known = self._known.get(at)
        if known is not None and known[0] == signature:
            return known[1]
        record = self._book.find(at[0], frame)
        if record is None:
            return None
        entry = Entry.of(record)
        self._known[at], self._changed = (signature, entry), True
        return entry

    def done(self, stage: object, frame: int, key: str) -> bool:
        """Whether a frame's record holds this key and its files are those that were committed."""
        entry = self.find(stage, frame)
        return entry is not None and entry.key == key and not self.damage(stage, frame)

    def damage(self, stage: object, frame: int) -> str:
        """What is wrong with a frame's files, in words; "" if nothing is.

        A file of another size or time is compared by digest, once: the index remembers the state that was checked.
        """
        entry = self.find(stage, frame)
        if entry is None:
            return ""
        for name, digest in entry.files.items():
            found, state = self._book.check_file(name, digest, entry.states.get(name))
            if found:
                return found
            if state is not None and state != entry.states.get(name):
                entry.states[name], self._changed = state, True
        return ""

    def files(self, root: Path) -> list[str]:
        """All files that records name, below the output folder `root`."""
        held = (self._known[at][1] for at in self._found.keys() & self._known.keys())
        return [str(root / name) for entry in held for name in entry.files]

    def save(self) -> None:
        """Writes the index if it has changed."""
        if not self._changed:
            return
        rows: dict[str, dict[str, list[Any]]] = {}
        settings = _Table()
        for at in self._found.keys() & self._known.keys():
            signature, entry = self._known[at]
            own = {name: value for name, value in entry.fields.items() if name != "settings"}
            row = [*signature, entry.key, own, settings.number(entry.fields.get("settings")), entry.seconds, entry.nfe]
            rows.setdefault(at[0], {})[at[1]] = [*row, entry.files, entry.states, entry.clamped]
        save_memory(self._memory, {"version": _VERSION, "settings": settings.rows, "records": rows})


class _Table:
    """Distinct documents, numbered: thousands of records share their settings."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._numbers: dict[str, int] = {}
        self._seen: dict[int, int] = {}

    def number(self, document: Any) -> int:
        """The number of a document; equal ones have the same."""
        if id(document) not in self._seen:
            text = json.dumps(document, sort_keys=True)
            if text not in self._numbers:
                self._numbers[text] = len(self.rows)
                self.rows.append(document)
            self._seen[id(document)] = self._numbers[text]
        return self._seen[id(document)]


def records_fingerprint(folder: Path) -> str:
    """Changes whenever a record is written, replaced or removed; reads none of them."""
    lines = sorted(f"{at[0]}/{at[1]} {signature}" for at, signature in _scan(folder))
    return hashlib.blake2b("\n".join(lines).encode(), digest_size=16).hexdigest()


def _scan(folder: Path) -> Iterator[tuple[tuple[str, str], Signature]]:
    """Stage and file name of every record, and the signature of its file."""
    try:
        stages = [entry for entry in os.scandir(folder) if entry.is_dir()]
    except OSError:
        return
    for stage in stages:
        with os.scandir(stage.path) as files:
            for file in files:
                if file.name.endswith(".json"):
                    found = file.stat()
                    yield (stage.name, file.name), (found.st_size, found.st_mtime_ns, found.st_ino)


def _load(memory: Path) -> dict[tuple[str, str], tuple[Signature, Entry]]:
    try:
        document = json.loads(memory.read_bytes())
        if document["version"] != _VERSION:
            return {}
        settings = document["settings"]
        return {
            (stage, name): _entry(row, settings)
            for stage, rows in document["records"].items()
            for name, row in rows.items()
        }
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError):
        return {}


def _entry(row: list[Any], settings: list[Any]) -> tuple[Signature, Entry]:
    size, time, inode, key, own, number, seconds, nfe, files, states, clamped = row
    fields = own if settings[number] is None else {**own, "settings": settings[number]}
    return (size, time, inode), Entry(key, fields, seconds, nfe, files, _states(states), clamped)


def _states(rows: Mapping[str, Any]) -> dict[str, FileState]:
    return {name: (row[0], row[1]) for name, row in rows.items()}
