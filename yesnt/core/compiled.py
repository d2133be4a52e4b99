"""Compiles kernels with Numba and caches their machine code (kernel_cache.py says where)."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

from numba import config, njit

from yesnt.core.kernel_cache import kernel_folder

_DECORATING = Lock()


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of kernels: `numba.njit(cache=True, **options)` with yesnt's own cache folder.

    Numba's cache checks a function's own file only. A kernel that calls a kernel of another file would run stale
    machine code after a change there. Here the folder is named by a digest of all sources that the machine code depends
    on. Every kernel of the package is therefore declared with this decorator; tests/test_architecture.py checks that.

    Args:
        options: of `numba.njit`, for instance `nogil=True`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        folder = kernel_folder(function.__module__.rpartition(".")[0])
        if folder is None:
            return njit(**options)(function)
        with _DECORATING:  # Numba reads the setting while it decorates; functions of others keep theirs
            before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
            try:
                return njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = before

    return decorate
