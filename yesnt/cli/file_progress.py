"""Progress of hashing and checking files, on stderr: a line every few seconds, none for a short job."""

from __future__ import annotations

import sys
import time

EVERY_SECONDS = 2.0


class FileProgress:
    """Prints `Hashing files: 1200 of 30000`, at most one line every few seconds."""

    def __init__(self) -> None:
        self._told = time.monotonic()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Takes one step of the work."""
        now = time.monotonic()
        if now - self._told >= EVERY_SECONDS:
            self._told = now
            print(f"{what}: {done} of {total}", file=sys.stderr, flush=True)
