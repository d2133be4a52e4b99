"""Measures what a task spends in its kernels."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """Wall and processor seconds inside kernels; reading inside a kernel does not count.

    Attributes:
        began: when the clock was made, seconds of `time.perf_counter`.
        kernel: wall seconds in kernels.
        kernel_processor: processor seconds of this thread in kernels.
    """

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self.kernel = self.kernel_processor = 0.0
        self._reading = False
        self._read = (0.0, 0.0)

    @property
    def seconds(self) -> float:
        """Wall seconds since the clock was made."""
        return time.perf_counter() - self.began

    @contextmanager
    def kernel_time(self) -> Iterator[None]:
        """Counts the time inside."""
        start, read = _now(), self._read
        try:
            yield
        finally:
            inside = _since(read, self._read)
            wall, processor = _since(inside, _since(start, _now()))
            self.kernel, self.kernel_processor = self.kernel + wall, self.kernel_processor + processor

    @contextmanager
    def reading_time(self) -> Iterator[None]:
        """Subtracts the time inside from the kernel around it; of nested readings the outermost counts."""
        if self._reading:
            yield
            return
        start, self._reading = _now(), True
        try:
            yield
        finally:
            spent, self._reading = _since(start, _now()), False
            self._read = (self._read[0] + spent[0], self._read[1] + spent[1])


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.thread_time()


def _since(start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
    return end[0] - start[0], end[1] - start[1]
