"""Reads everything that is committed and compares it with its record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from yesnt.core.errors import CorruptError
from yesnt.io.file_digests import file_digest
from yesnt.io.records import Record, key_of
from yesnt.io.store import FrameStore
from yesnt.planning.graph import Node
from yesnt.runtime.session import Session


@dataclass(frozen=True)
class Damage:
    """A committed frame that is no longer as it was.

    Attributes:
        stage: label of the stage.
        frame: frame number.
        what: what is damaged, in words.
    """

    stage: str
    frame: int
    what: str


def verify(session: Session) -> list[Damage]:
    """Everything that differs from its record.

    A record that cannot be read, or whose key is not the hash of its fields, counts as damage as well.
    """
    store = FrameStore(session.output.store)
    graph = session.graph()
    return [damage for node in graph for frame in node.frames for damage in _check(session, store, node, frame)]


def _check(session: Session, store: FrameStore, node: Node, frame: int) -> Iterator[Damage]:
    stage = node.stage.label
    if not session.book.path(stage, frame).exists():
        return
    record = session.book.find(stage, frame)
    if record is None or (_of_this_version(record, node) and key_of(record.fields) != record.key):
        yield Damage(stage, frame, "its record is damaged")
        return
    yield from _check_arrays(session, store, record)
    for name, digest in record.files.items():
        path = session.output.root / name
        if not path.is_file():
            yield Damage(stage, frame, f"{name} is missing")
        elif file_digest(path) != digest:
            yield Damage(stage, frame, f"{name} is not the file that was committed")


def _of_this_version(record: Record, node: Node) -> bool:
    """Whether a record's key is made by today's rules; one of another version is stale, not damaged."""
    return bool(record.fields.get("version") == node.fields["version"])


def _check_arrays(session: Session, store: FrameStore, record: Record) -> Iterator[Damage]:
    for name, digest in record.arrays.items():
        try:
            store.read(name, session.job.position(record.frame), digest)
        except CorruptError as error:
            yield Damage(record.stage, record.frame, error.what)
        except (OSError, KeyError, ValueError) as error:
            yield Damage(record.stage, record.frame, f"array {name} cannot be read ({error})")
