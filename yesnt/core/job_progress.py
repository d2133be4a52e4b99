"""How long work on many files tells how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many items are done, and their total."""


def no_progress(what: str, done: int, total: int) -> None:
    """Reports nothing."""
