"""Byte-bounded LRU cache of decoded arrays, one per worker process, so that stages share decoded files.

Every key must name the content: the digest of a file or of a committed frame, never a path alone. A worker may
serve several runs, and a path may hold another file in the next one.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

from cachetools import LRUCache
from numpy.typing import NDArray

T = TypeVar("T")

CACHE_BYTES = 48 << 20
"""Default capacity: a dozen small frames. A long shot fills it and a short one does not, so it bounds how memory grows
with the length of a shot."""

LARGEST_SHARE = 4
"""A value larger than the capacity divided by this is not kept: it would evict nearly everything else."""


class ArrayCache:
    """The most recently used values, of bounded size together; safe to use from several threads.

    Args:
        capacity: bytes of all arrays together.
    """

    def __init__(self, capacity: int = CACHE_BYTES) -> None:
        self._largest = capacity // LARGEST_SHARE
        self._items: LRUCache[Hashable, tuple[Any, int]] = LRUCache(capacity, getsizeof=lambda item: item[1])
        self._lock = Lock()

    @property
    def held(self) -> int:
        """Bytes of the arrays that are held."""
        return int(self._items.currsize)

    def clear(self) -> None:
        """Drops everything."""
        with self._lock:
            self._items.clear()

    def fetch(self, key: Hashable, make: Callable[[], T], arrays: Callable[[T], tuple[NDArray[Any], ...]]) -> T:
        """The value of a key: the cached one, or made and then kept.

        Args:
            key: names the value's content; two different values never have equal keys.
            make: reads or computes the value; called outside the lock, so two threads may both make it.
            arrays: the arrays that a value holds, for its size. Callers share the value and must not write to them.
        """
        with self._lock:
            found = self._items.get(key)
        if found is not None:
            value: T = found[0]
            return value
        value = make()
        self.put(key, value, sum(array.nbytes for array in arrays(value)))
        return value

    def put(self, key: Hashable, value: object, size: int) -> None:
        """Keeps a value of `size` bytes and evicts the least recently used ones until all fit."""
        if size > self._largest:
            return
        with self._lock:
            self._items[key] = (value, size)
