"""The index says what the records say, reads each record once, and may be damaged or deleted."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from yesnt.io import records
from yesnt.io.record_index import RecordIndex, records_fingerprint
from yesnt.io.records import Record, RecordBook, file_digest, file_state


@pytest.fixture
def book(tmp_path: Path) -> RecordBook:
    """Two stages of two frames; one delivers files."""
    (tmp_path / "exr").mkdir()
    book = RecordBook(tmp_path / "run" / "records", tmp_path)
    for frame in (1, 2):
        name = f"exr/a.{frame:04d}.exr"
        (tmp_path / name).write_text(f"picture {frame}")
        files, states = {name: file_digest(tmp_path / name)}, {name: file_state(tmp_path / name)}
        fields = {"settings": {"a": [1, 2]}, "frame": frame}
        book.commit(Record("relight", frame, f"r{frame}", fields, seconds={"task": 0.5}, facts={"nfe": 7}))
        book.commit(Record("composite", frame, f"c{frame}", fields, {}, files, file_states=states))
    return book


def open_index(book: RecordBook) -> RecordIndex:
    index = RecordIndex(book, book.folder.parent / "record_index.json")
    for stage in ("relight", "composite"):
        for frame in (1, 2, 3):
            index.find(stage, frame)
    index.save()
    return index


def test_entries_are_those_of_the_records(book: RecordBook) -> None:
    for index in (open_index(book), open_index(book)):  # read from the records, then from the index
        entry = index.find("relight", 2)
        assert entry is not None
        assert (entry.key, entry.seconds, entry.nfe) == ("r2", 0.5, 7)
        assert entry.fields == {"settings": {"a": [1, 2]}, "frame": 2}
        assert index.find("relight", 3) is None
        assert index.done("composite", 1, "c1")
        assert not index.done("composite", 1, "other")


def test_a_record_is_read_once(book: RecordBook, monkeypatch: pytest.MonkeyPatch) -> None:
    open_index(book)
    monkeypatch.setattr(RecordBook, "find", lambda *at: pytest.fail(f"{at} is read again"))
    assert open_index(book).find("relight", 1) is not None


def test_records_that_change_are_read_again(book: RecordBook) -> None:
    open_index(book)
    before = records_fingerprint(book.folder)
    book.commit(Record("relight", 1, "new", {}))
    book.forget("relight", 2)
    book.path("composite", 1).write_text("{")  # damaged in place
    index = open_index(book)
    assert index.find("relight", 1).key == "new"
    assert index.find("relight", 2) is None
    assert index.find("composite", 1) is None
    assert index.find("composite", 2).key == "c2"
    assert records_fingerprint(book.folder) != before


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"version": 1}', '{"version": 1, "settings": [], "records": {"a": {"1": 3}}}']
)
def test_a_damaged_index_is_built_anew(book: RecordBook, text: str) -> None:
    (book.folder.parent / "record_index.json").write_text(text)
    assert open_index(book).find("relight", 1).key == "r1"
    assert json.loads((book.folder.parent / "record_index.json").read_text())["records"]


def test_deleted_and_replaced_files_are_noticed(book: RecordBook, tmp_path: Path) -> None:
    one, two = (tmp_path / "exr" / f"a.{frame:04d}.exr" for frame in (1, 2))
    one.unlink()
    two.write_text("another")
    index = open_index(book)
    assert index.damage("composite", 1) == "exr/a.0001.exr is missing"
    assert index.damage("composite", 2) == "exr/a.0002.exr is not the file that was committed"
    assert not index.done("composite", 1, "c1")
    assert book.done("composite", 1, "c1") is None
    assert book.done("composite", 2, "c2") is None


def test_a_file_that_was_only_touched_is_read_once_and_stays_done(
    book: RecordBook, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, read = tmp_path / "exr" / "a.0001.exr", []
    monkeypatch.setattr(records, "file_digest", lambda p: read.append(p.name) or file_digest(p))
    assert open_index(book).done("composite", 1, "c1")
    assert read == [], "an untouched file is not read"
    os.utime(path, ns=(1, 1))
    for _ in range(2):
        index = open_index(book)
        assert index.done("composite", 1, "c1")
        index.save()
    assert read == ["a.0001.exr"]
