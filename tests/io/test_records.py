import json
from pathlib import Path

import pytest

from yesnt.io.durable import durable_path, sweep_partials, write_json
from yesnt.io.records import Record, RecordBook, key_of


def test_key_depends_on_content_and_not_on_order() -> None:
    assert key_of({"a": 1, "b": [1, 2]}) == key_of({"b": [1, 2], "a": 1})
    assert key_of({"a": 1}) != key_of({"a": 2})
    with pytest.raises(ValueError, match="not JSON compliant"):
        key_of({"a": float("nan")})


def test_done_means_the_same_key(tmp_path: Path) -> None:
    book = RecordBook(tmp_path)
    book.commit(Record("relight", 1001, "k", {"x": 1}, {"a": "d"}))
    assert book.done("relight", 1001, "k") is not None
    assert book.done("relight", 1001, "other") is None
    assert book.done("relight", 1002, "k") is None


@pytest.mark.parametrize("text", ["", "{", "[]", '{"stage": "relight"}'])
def test_an_unreadable_record_is_no_record(tmp_path: Path, text: str) -> None:
    book = RecordBook(tmp_path)
    book.path("relight", 1).parent.mkdir()
    book.path("relight", 1).write_text(text)
    assert book.find("relight", 1) is None


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_json(path, {"a": 1})
    with pytest.raises(RuntimeError), durable_path(path) as temporary:  # noqa: PT012 - the failure comes in between
        temporary.write_text("half")
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
    assert "1" in path.read_text()


def test_litter_of_killed_processes_is_swept(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / ".0.123.partial").write_text("half")
    (tmp_path / "keep.exr").write_text("whole")
    assert sweep_partials(tmp_path) == 1
    assert (tmp_path / "keep.exr").exists()


def test_a_record_with_any_flipped_bit_is_not_believed(tmp_path: Path) -> None:
    book = RecordBook(tmp_path)
    fields = {"stage": "relight", "version": 1}
    seconds, facts = {"task": 0.30000000000000004}, {"host": "h"}
    book.commit(Record("relight", 1001, key_of(fields), fields, {"diffuse": "d" * 32}, {}, seconds, facts))
    path = book.path("relight", 1001)
    data = path.read_bytes()
    assert book.find("relight", 1001) is not None
    for bit in range(0, 8 * len(data), 7):  # every place in a byte, and nearly every byte
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bytes(flipped))
        assert book.find("relight", 1001) is None, f"bit {bit % 8} of byte {bit // 8}"


def test_a_record_of_an_older_version_has_no_check_and_is_read(tmp_path: Path) -> None:
    book = RecordBook(tmp_path)
    path = book.path("relight", 1001)
    path.parent.mkdir(parents=True)
    document = {"stage": "relight", "frame": 1001, "key": "k", "fields": {}}
    path.write_text(json.dumps(document))
    assert book.find("relight", 1001) == Record(**document)


def test_a_record_that_lies_in_the_place_of_another_is_not_believed(tmp_path: Path) -> None:
    book = RecordBook(tmp_path)
    for stage, frame in (("relight", 1001), ("relight", 1002), ("flow", 1001)):
        book.commit(Record(stage, frame, "k", {}))
    book.path("relight", 1001).write_bytes(book.path("relight", 1002).read_bytes())
    book.path("flow", 1001).write_bytes(book.path("relight", 1002).read_bytes())
    assert book.find("relight", 1001) is None
    assert book.find("flow", 1001) is None
    assert book.find("relight", 1002) is not None
