"""Compiler options of the rasteriser's kernels."""

from __future__ import annotations

from yesnt.core.compiled import compiled

kernel = compiled(error_model="numpy", fastmath=True, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""A function that other compiled functions call; LLVM inlines it, so that there is one version of its arithmetic."""

entry = compiled(error_model="numpy", fastmath=True, nogil=True, no_cfunc_wrapper=True)
"""A function that Python calls over a range of Gaussians, tiles or rows, in several threads (relight/ranges.py)."""
