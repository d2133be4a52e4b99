"""How relighting's kernels are compiled: they borrow the arrays of their caller.

Numba counts references to every array that a function takes out of a tuple or cuts a view from: an atomic addition
each, some two hundred and fifty a pixel here, on counters that all threads share. None of these functions makes an
array or keeps one, so the caller's references are enough and counting is left out (`_nrt`, the runtime that counts).
"""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, fastmath=True, error_model="numpy", _nrt=False)
"""Of functions that make no array; the compiler refuses one that does."""

inlined = njit(cache=True, fastmath=True, error_model="numpy", _nrt=False, inline="always")
"""The same for small parts, which are compiled into each of their callers."""
