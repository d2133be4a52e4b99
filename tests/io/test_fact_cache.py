"""Facts are computed once for a key, survive a process, and are computed again where their file is damaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from yesnt.io.fact_cache import FactCache


def fetch(folder: Path, computed: list[int], *numbers: int) -> list[int]:
    facts = FactCache(folder / "facts.json")
    found = [facts.fetch(str(n), lambda n=n: computed.append(n) or n * n) for n in numbers]
    facts.save()
    return found


def test_a_fact_is_computed_once(tmp_path: Path) -> None:
    computed: list[int] = []
    assert fetch(tmp_path, computed, 2, 3, 2) == [4, 9, 4]
    assert fetch(tmp_path, computed, 3, 4) == [9, 16]
    assert computed == [2, 3, 4]
    facts = FactCache(tmp_path / "facts.json")
    assert facts.knows("4")
    assert not facts.knows("5")


@pytest.mark.parametrize("text", ["", "[]", '{"version": 1, "facts": 3}', '{"version": 2, "facts": {}}'])
def test_a_damaged_memory_is_ignored(tmp_path: Path, text: str) -> None:
    (tmp_path / "facts.json").write_text(text)
    computed: list[int] = []
    assert fetch(tmp_path, computed, 2) == [4]
    fetch(tmp_path, computed, 2)
    assert computed == [2]


def test_facts_that_nobody_asks_for_go_at_last(tmp_path: Path) -> None:
    fetch(tmp_path, [], *range(100))
    fetch(tmp_path, [], 1000)
    computed: list[int] = []
    fetch(tmp_path, computed, *range(100))
    assert len(computed) > 90
    assert 99 not in computed, "the last ones are kept: a setting may be set back"


def test_an_error_is_not_a_fact(tmp_path: Path) -> None:
    facts = FactCache(tmp_path / "facts.json")
    with pytest.raises(ZeroDivisionError):
        facts.fetch("0", lambda: 1 // 0)
    assert not facts.knows("0")
