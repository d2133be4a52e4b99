"""Digests of files are remembered by what changes with their content, and never trusted where that is in doubt."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from yesnt.core.errors import JobError
from yesnt.io import file_digests
from yesnt.io.file_digests import FileDigests, file_digest


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that were read; all files are old enough to be remembered."""
    names: list[str] = []

    def counted(path: Path) -> str:
        names.append(path.name)
        return file_digest(path)

    monkeypatch.setattr(file_digests, "file_digest", counted)
    monkeypatch.setattr(file_digests, "SETTLED_SECONDS", -1.0)
    return names


def digests(folder: Path, *names: str) -> dict[str, str]:
    memory = FileDigests(folder / "memory.json")
    found = memory.of([folder / name for name in names])
    memory.save()
    return found


def test_a_file_is_read_once(tmp_path: Path, read: list[str]) -> None:
    for name in "ab":
        (tmp_path / name).write_text(name)
    first = digests(tmp_path, "a", "b")
    assert first == {str(tmp_path / name): file_digest(tmp_path / name) for name in "ab"}
    assert digests(tmp_path, "a", "b") == first
    assert sorted(read) == ["a", "b"]


@pytest.mark.parametrize("way", ["rewritten", "replaced", "same size and time"])
def test_a_changed_file_is_read_again(tmp_path: Path, read: list[str], way: str) -> None:
    path = tmp_path / "a"
    path.write_text("one")
    before, at = digests(tmp_path, "a"), path.stat().st_mtime_ns
    if way == "replaced":
        (tmp_path / "new").write_text("two")
        os.replace(tmp_path / "new", path)
    else:
        path.write_text("three" if way == "rewritten" else "two")
    if way != "rewritten":
        os.utime(path, ns=(at, at))
    after = digests(tmp_path, "a")
    assert after != before
    assert after[str(path)] == file_digest(path)


def test_a_file_that_has_just_changed_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("one")
    digests(tmp_path, "a")
    names: list[str] = []
    monkeypatch.setattr(file_digests, "file_digest", lambda path: names.append(path.name) or "d")
    digests(tmp_path, "a")
    assert names == ["a"]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 1}', '{"version": 1, "files": {"a": 3}}', "{}"])
def test_a_damaged_memory_is_ignored_and_written_anew(tmp_path: Path, read: list[str], text: str) -> None:
    (tmp_path / "a").write_text("one")
    (tmp_path / "memory.json").write_text(text)
    assert digests(tmp_path, "a") == {str(tmp_path / "a"): file_digest(tmp_path / "a")}
    digests(tmp_path, "a")
    assert read == ["a"]
    assert json.loads((tmp_path / "memory.json").read_text())["version"] == 1


def test_memory_is_for_where_there_is_room_for_it(tmp_path: Path, read: list[str]) -> None:
    (tmp_path / "a").write_text("one")
    memory = FileDigests(tmp_path / "absent" / "memory.json")
    memory.of([tmp_path / "a"])
    memory.save()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_is_no_longer_asked_for_is_forgotten(tmp_path: Path, read: list[str]) -> None:
    for name in "ab":
        (tmp_path / name).write_text(name)
    digests(tmp_path, "a", "b")
    digests(tmp_path, "a")
    assert list(json.loads((tmp_path / "memory.json").read_text())["files"]) == [str(tmp_path / "a")]


def test_progress_is_reported_for_what_is_read(tmp_path: Path, read: list[str]) -> None:
    for name in "abc":
        (tmp_path / name).write_text(name)
    digests(tmp_path, "a")
    told: list[tuple[int, int]] = []
    paths = [tmp_path / name for name in "abc"]
    FileDigests(tmp_path / "memory.json").of(paths, lambda done, total: told.append((done, total)))
    assert told == [(1, 2), (2, 2)]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"A file is missing. Where: .*/a"):
        digests(tmp_path, "a")
    (tmp_path / "a").mkdir()
    with pytest.raises(JobError, match=r"cannot be read \(Is a directory\)"):
        digests(tmp_path, "a")
    shutil.rmtree(tmp_path / "a")
