"""Resident memory of a worker process."""

from __future__ import annotations

import ctypes
import resource


def trim_memory() -> None:
    """Returns freed pages to the system (glibc; elsewhere they stay): gaps between longer-lived blocks add up."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
