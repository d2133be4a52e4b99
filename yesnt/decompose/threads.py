"""Thread count of network inference: one, so that results have the same bits on every machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Context manager and decorator that runs torch on one thread and restores the count afterwards.

    Two threads sum small convolutions in another order (differences up to 5e-6 in one layer). Parallelism comes from
    frames in separate processes, so a single thread costs no throughput.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
