"""The shelf: one reading for all, bounded in bytes, never a stale file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from yesnt.io.array_cache import Shelf, file_identity


def fetch(shelf: Shelf, key: object, made: list[object], size: int = 100) -> np.ndarray:
    def make() -> np.ndarray:
        made.append(key)
        return np.zeros(size, np.uint8)

    return shelf.fetch(key, make, lambda array: (array,))


def test_a_value_is_made_once_while_it_is_on_the_shelf() -> None:
    shelf, made = Shelf(1000), []
    assert fetch(shelf, "a", made) is fetch(shelf, "a", made)
    assert made == ["a"]


def test_the_least_recently_used_go_first_and_the_bound_holds() -> None:
    shelf, made = Shelf(1000), []
    for key in range(10):
        fetch(shelf, key, made)
    fetch(shelf, 0, made)  # used again: 1 is the oldest now
    for key in range(10, 200):
        fetch(shelf, key, made)
        assert shelf.held <= 1000
    fetch(shelf, 199, made)
    assert made.count(199) == 1
    fetch(shelf, 0, made)
    assert made.count(0) == 2


def test_what_is_large_is_not_kept() -> None:
    shelf, made = Shelf(1000), []
    fetch(shelf, "4K", made, size=300)
    assert shelf.held == 0


def test_a_rewritten_file_has_another_identity(tmp_path: Path) -> None:
    path = tmp_path / "plate.exr"
    path.write_bytes(b"one")
    before = file_identity(path)
    assert file_identity(path) == before
    path.write_bytes(b"three")
    assert file_identity(path) != before
