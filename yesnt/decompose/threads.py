"""The number of threads that a network runs on: one, so that its bits are the same everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Runs torch on one thread inside, as before outside; also a decorator.

    Small convolutions are summed in another order by two threads (up to 5e-6 in one layer). What runs side by side is
    frames, a process each, so nothing is lost.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
