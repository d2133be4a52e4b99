"""Compiler options of the relighting kernels: they borrow the arrays of their caller.

Numba counts references to every array that a function takes out of a record or cuts a view from. Each is an atomic
addition, about 250 per pixel here, on counters that all threads share. None of these functions allocates an array or
keeps one, so the references of the caller are enough and counting is switched off (`_nrt`, Numba's runtime for memory).
The compiler refuses such a function if it allocates.

Kernels with `fastmath` may be reassociated by the compiler. Those that decide (is a pixel hidden, which pixel is
nearest) are compiled without, as `exact_*`.
"""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, fastmath=True, error_model="numpy", _nrt=False)
"""A function that other compiled functions call."""

inlined = njit(cache=True, fastmath=True, error_model="numpy", _nrt=False, inline="always")
"""The same for small parts, which are compiled into each of their callers."""

entry = njit(cache=True, fastmath=True, error_model="numpy", _nrt=False, nogil=True)
"""A function that Python calls over a range of pixels, in several threads (relight/ranges.py)."""

exact_kernel = njit(cache=True, error_model="numpy", _nrt=False)
"""As `kernel`, in the order of arithmetic that the source states."""

exact_inlined = njit(cache=True, error_model="numpy", _nrt=False, inline="always")
"""As `inlined`, in the order of arithmetic that the source states."""

exact_entry = njit(cache=True, error_model="numpy", _nrt=False, nogil=True)
"""As `entry`, in the order of arithmetic that the source states."""
