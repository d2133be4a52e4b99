"""Ordered map over a few threads that stops early where its caller does."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
U = TypeVar("U")


def parallel_map(call: Callable[[T], U], items: Iterable[T], threads: int) -> Iterator[U]:
    """The results of `call` in the order of `items`.

    After an error, an interrupt, or when the iterator is closed, calls that have not begun are dropped: a user who
    interrupts a long list waits for the calls under way only.
    """
    pool = ThreadPoolExecutor(threads)
    try:
        yield from pool.map(call, items)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
