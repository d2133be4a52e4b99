"""What a worker decoded a moment ago: a shelf of arrays, bounded in bytes, so that stages share one reading."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from numpy.typing import NDArray

T = TypeVar("T")

SHELF_BYTES = 48 << 20
"""Enough for a dozen small frames; what is larger than a quarter is read each time. A long shot fills it and a short
one does not, so it counts in how memory grows with length."""


@dataclass(frozen=True)
class _Item:
    value: object
    size: int


class Shelf:
    """The most recently used values, at most `capacity` bytes of them.

    Args:
        capacity: bytes of all arrays together; a value that is larger than a quarter of it is not kept.
    """

    def __init__(self, capacity: int = SHELF_BYTES) -> None:
        self._capacity, self._held = capacity, 0
        self._items: OrderedDict[Hashable, _Item] = OrderedDict()
        self._lock = Lock()

    @property
    def held(self) -> int:
        """Bytes on the shelf."""
        return self._held

    def clear(self) -> None:
        """Takes everything off."""
        with self._lock:
            self._items.clear()
            self._held = 0

    def fetch(self, key: Hashable, make: Callable[[], T], arrays: Callable[[T], tuple[NDArray[Any], ...]]) -> T:
        """The value of a key: from the shelf, or made and put there.

        Args:
            key: must change whenever the value would.
            make: reads or computes the value.
            arrays: the arrays that a value holds; whoever gets a value from a shelf must not write to them.
        """
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key].value  # type: ignore[return-value]
        value = make()
        self.put(key, value, sum(array.nbytes for array in arrays(value)))
        return value

    def put(self, key: Hashable, value: object, size: int) -> None:
        """Keeps a value and drops the oldest ones until all fit."""
        if size > self._capacity // 4:
            return
        with self._lock:
            if key in self._items:
                self._held -= self._items.pop(key).size
            self._items[key] = _Item(value, size)
            self._held += size
            while self._held > self._capacity:
                self._held -= self._items.popitem(last=False)[1].size


def file_identity(path: Path) -> tuple[str, int, int, int]:
    """Changes whenever a file is replaced or rewritten: path, inode, size, time of its last change in nanoseconds.

    Good enough to share a reading for seconds inside one process; what counts as done is never decided by it.
    """
    found = path.stat()
    return str(path), found.st_ino, found.st_size, found.st_mtime_ns
