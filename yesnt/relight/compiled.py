"""Compiler options of the relighting kernels: they borrow the arrays of their caller.

Numba counts references to every array that a function takes out of a record or cuts a view from. Each is an atomic
addition, about 250 per pixel here, on counters that all threads share. None of these functions allocates an array or
keeps one, so the references of the caller are enough and counting is switched off (`_nrt`, Numba's runtime for memory).
The compiler refuses such a function if it allocates.

Kernels with `fastmath` may be reassociated by the compiler. Those that decide (is a pixel hidden, which pixel is
nearest) are compiled without, as `exact_*`. Functions that only kernels call have no entry points for Python and C,
which take a tenth of the compile time.

Functions that only kernels call are inlined into their callers by LLVM (`forceinline`). With `fastmath` a function that
stayed by itself would have several compiled versions that differ in the last bit, one per module that holds it, and a
process that compiles would link another one than a process that loads from the cache (tests/relight/test_compiled.py).
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from yesnt.core.compiled import compiled

_EXACT: MappingProxyType[str, Any] = MappingProxyType({"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True})
_EXACT_INNER: MappingProxyType[str, Any] = MappingProxyType({**_EXACT, "no_cpython_wrapper": True})

kernel = compiled(**_EXACT_INNER, fastmath=True, forceinline=True)
"""A function that other compiled functions call."""

inlined = compiled(**_EXACT_INNER, fastmath=True, inline="always")
"""The same for small parts, which are compiled into each of their callers."""

entry = compiled(**_EXACT, fastmath=True, nogil=True)
"""A function that Python calls over a range of pixels, in several threads (relight/ranges.py)."""

exact_kernel = compiled(**_EXACT_INNER, forceinline=True)
"""As `kernel`, in the order of arithmetic that the source states."""

exact_inlined = compiled(**_EXACT_INNER, inline="always")
"""As `inlined`, in the order of arithmetic that the source states."""

exact_entry = compiled(**_EXACT, nogil=True)
"""As `entry`, in the order of arithmetic that the source states."""
