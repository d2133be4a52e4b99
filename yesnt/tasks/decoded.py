"""LRU caches of what this worker process decoded last, keyed by content: stages of one frame share decoded files."""

from __future__ import annotations

from yesnt.io.array_cache import ArrayCache
from yesnt.tasks.memory import trim_memory

FRAMES = ArrayCache()
"""Plates, G-buffers and frames of the store."""

MATTES = ArrayCache(8 << 20)
"""Mattes as bits, a sixtieth of their plates: the solver needs those of many frames, whose plates have been dropped."""


def release_memory() -> None:
    """Clears the cache of frames and returns freed pages to the system.

    A worker keeps freed pages for its next frame (`worker_settings.ALLOCATOR`). Before a task whose own lists are
    large, they would add to its peak.
    """
    FRAMES.clear()
    trim_memory()
