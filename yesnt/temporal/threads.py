"""Runs kernels on groups of frames, one thread per group. Kernels release the interpreter lock.

Numba's `prange` takes twice as long to compile, and small problems wait for its threads on a busy machine.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from yesnt.temporal.geometry import Geometry

PIXELS_PER_THREAD = 100_000
"""Matte pixels per thread; for fewer a thread costs more than it saves."""


def frame_groups(geometry: Geometry, threads: int) -> NDArray[np.int64]:
    """Splits the frames into at most `threads` groups of similar pixel counts; returns their edges [G + 1].

    One group if a frame has a single pixel, because stencils into it then touch the frame before (geometry.py).
    """
    frames = geometry.frames
    if np.any(np.diff(frames) == 1):
        threads = 1
    targets = frames[-1] * np.arange(1, threads) / threads
    edges = np.searchsorted(frames, targets)
    return np.unique(np.concatenate([[0], edges, [len(frames) - 1]])).astype(np.int64)


class FrameThreads:
    """Runs kernels with at most NUMBA_NUM_THREADS threads, fewer for small problems."""

    def __init__(self, geometry: Geometry) -> None:
        threads = max(1, min(get_num_threads(), geometry.pixels // PIXELS_PER_THREAD))
        edges = frame_groups(geometry, threads)
        self.spans = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
        self.pool = ThreadPoolExecutor(len(self.spans), "frames") if len(self.spans) > 1 else None

    def run(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Calls kernel(first, last, *arguments) for every group of frames and waits."""
        if self.pool is None:
            for first, last in self.spans:
                kernel(first, last, *arguments)
            return
        calls = [self.pool.submit(kernel, first, last, *arguments) for first, last in self.spans]
        for call in calls:
            call.result()
