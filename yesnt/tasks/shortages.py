"""Errors of a task that another process causes, and that pass: they are shortages, not failures of a frame."""

from __future__ import annotations

import sys

from yesnt.core.errors import ShortageError

OTHERS_BYTES = 1_500_000_000
"""GPU memory that is neither free nor reserved here from which another process is at work; a context takes 0.5 GB."""


def shortage_of(error: Exception) -> ShortageError | None:
    """The shortage behind an error; None if the task itself failed, for example because its frame is too large.

    Args:
        error: what a task raised.
    """
    torch = sys.modules.get("torch")  # without it there is no GPU memory that could be full
    if torch is None or not isinstance(error, torch.OutOfMemoryError) or not torch.cuda.is_available():
        return None
    free, total = torch.cuda.mem_get_info()
    others = total - free - torch.cuda.memory_reserved()
    if others < OTHERS_BYTES:
        return None
    return ShortageError(
        f"The GPU is busy: other processes hold {others / 1e9:.1f} GB of its {total / 1e9:.1f} GB",
        torch.cuda.get_device_name(), "a GPU of its own for each worker", "nothing: the stage goes on when it is free",
    )  # fmt: skip
