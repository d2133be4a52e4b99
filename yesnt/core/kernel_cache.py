"""Where the machine code of kernels is cached: one folder per package and version of its sources.

The root is $YESNT_CACHE_DIR, else $XDG_CACHE_HOME/yesnt, else ~/.cache/yesnt; if none of these is writable, a folder in
the system's temporary folder that only this user can write. A folder below it is named by the package and a digest of
the kernels' sources, Python, Numba, the processor and the place of the package. A changed source gives another folder,
so stale machine code is never run. Folders that were not used for a day are removed once there are many.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import tempfile
import time
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from yesnt.core.kernel_sources import PACKAGE, kernel_sources

KEPT = 4
"""Folders per package that are kept, the most recently used ones."""

IN_USE_SECONDS = 86400.0
"""A folder used within this time is kept in any case: a process may still read it."""


@lru_cache(maxsize=16)
def kernel_folder(package: str) -> Path | None:
    """The cache folder of a package's kernels (`yesnt.relight`), marked as used; None if no folder is writable."""
    root = cache_root()
    if root is None:
        return None
    name = package.partition(".")[2].replace(".", "-") or package
    folder = root / f"{name}-{sources_digest(package)}"
    try:
        if not folder.exists():
            prune(root, name)
            folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:
        return None
    return folder


def cache_root() -> Path | None:
    """The first writable root, created if need be; None if there is none."""
    wanted = os.environ.get("YESNT_CACHE_DIR")
    parent = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    for root in (Path(wanted or Path(parent, "yesnt")), _temporary_root()):
        with suppress(OSError):
            root.mkdir(mode=0o700, parents=True, exist_ok=True)
            if os.access(root, os.W_OK) and _is_private(root):
                return root
    return None


def _temporary_root() -> Path:
    return Path(tempfile.gettempdir(), f"yesnt-{os.getuid()}")


def _is_private(root: Path) -> bool:
    """Whether only this user can have written a root: cached machine code is run unseen.

    A folder that the user or an administrator chose is accepted; a name in the shared temporary folder can be taken by
    anybody.
    """
    if root != _temporary_root():
        return True
    status = root.lstat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022 and not root.is_symlink()


def sources_digest(package: str) -> str:
    """16 hexadecimal digits of all that machine code depends on."""
    from llvmlite import binding

    state = hashlib.blake2b(digest_size=8)
    features = os.environ.get("NUMBA_CPU_FEATURES", binding.get_host_cpu_features().flatten())
    processor = os.environ.get("NUMBA_CPU_NAME", binding.get_host_cpu_name())
    facts = (platform.python_version(), version("numba"), version("llvmlite"), processor, features, str(PACKAGE))
    for fact in facts:
        state.update(fact.encode() + b"\0")
    for path in kernel_sources(package):
        state.update(str(path.relative_to(PACKAGE)).encode() + b"\0" + path.read_bytes() + b"\0")
    return state.hexdigest()


def prune(root: Path, name: str) -> None:
    """Removes the folders of a package beyond the `KEPT` most recently used, unless they were used within a day."""
    used = {}
    for folder in root.glob(f"{name}-????????????????"):
        with suppress(OSError):  # another process may remove it at the same time
            used[folder] = folder.stat().st_mtime
    for folder in sorted(used, key=lambda f: -used[f])[KEPT:]:
        if used[folder] < time.time() - IN_USE_SECONDS:
            shutil.rmtree(folder, ignore_errors=True)
