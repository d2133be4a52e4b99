"""Runs a compiled kernel over ranges of pixels in several threads.

One compiled function serves one thread and many. Numba's own parallel loops would compile every kernel four times.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba

LEAST = 256
"""Items that are worth a thread."""

_PARTS = 4  # ranges per thread, so that ranges of unequal cost balance


def over_ranges(count: int, run: Callable[[int, int], None]) -> None:
    """Calls `run(first, last)` over consecutive ranges that cover [0, count), in at most Numba's number of threads.

    Args:
        count: items, at least 0.
        run: computes items [first, last) and releases the GIL; items must not depend on each other.
    """
    threads = min(numba.get_num_threads(), count // LEAST)
    if threads <= 1:
        run(0, count)
        return
    edges = [count * i // (_PARTS * threads) for i in range(_PARTS * threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, edges[:-1], edges[1:]))
