"""Files that are whole or absent: temporary name in the same folder, fsync, rename, fsync of the folder."""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from yesnt.core.errors import CorruptError, YesntError
from yesnt.core.fault_points import fault_point

T = TypeVar("T")

PARTIAL = ".partial"
"""Suffix of files that a killed process may leave; they are ignored and swept at the next run."""

TRANSIENT = frozenset({errno.EACCES, errno.EAGAIN, errno.EBUSY, errno.ESTALE, errno.ETXTBSY})
"""Errors that network disks, virus scanners and viewers of a folder cause for a moment."""

PAUSES = (0.05, 0.2, 0.5, 1.0, 2.0)
"""Seconds between attempts after a transient error. A lasting one (no permission) is reported after their sum."""


def retried(call: Callable[[], T]) -> T:
    """The result of a file operation, which is tried again after transient errors.

    Raises:
        OSError: any other error at once, a transient one after the last attempt.
    """
    for pause in PAUSES:
        try:
            return call()
        except OSError as error:
            if error.errno not in TRANSIENT:
                raise
        time.sleep(pause)
    return call()


@contextmanager
def durable_path(path: Path, prove: Callable[[Path], None] = lambda written: None) -> Iterator[Path]:
    """Yields a temporary path to write to; on success it becomes `path`, on any error it is removed.

    `prove` reads the synced file back and raises if it is not what was written. The name holds the process id, so two
    processes that race for the same file each rename a whole file of their own.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}")
    try:
        yield temporary
        sync_file(temporary)
        prove(temporary)
        fault_point(f"{path.suffix.lstrip('.') or 'shard'}.before_rename")  # shards are the files without a suffix
        retried(lambda: os.replace(temporary, path))
        sync_folder(path.parent)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if is_full(error):  # libraries say so in their own ways, and some of their errors cannot be sent from a worker
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        raise


def is_full(error: BaseException) -> bool:
    """Whether an error, of whatever class, says that the disk or the user's share of it is full."""
    full = (errno.ENOSPC, errno.EDQUOT)
    return getattr(error, "errno", None) in full or any(os.strerror(code) in str(error) for code in full)


def disk_full(error: BaseException, doing: str = "") -> YesntError:
    """A full disk in the user's words."""
    where = ", ".join(part for part in (getattr(error, "filename", None) or "the output folder", doing) if part)
    return YesntError(
        "The disk is full", where, "room for the frame store and the EXRs (`yesnt plan` says how much)",
        "free some and run again: nothing is lost",
    )  # fmt: skip


def sync_file(path: Path) -> None:
    """Waits until the file's bytes are on the disk."""
    retried(lambda: _sync(path))


def sync_folder(folder: Path) -> None:
    """Waits until the folder's entries are on the disk."""
    retried(lambda: _sync(folder))


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_bytes(path: Path, data: bytes) -> None:
    """Writes a whole file durably; its bytes are read back before it gets its name.

    Raises:
        CorruptError: what was read back is not what was written.
    """

    def prove(written: Path) -> None:
        if retried(written.read_bytes) != data:
            raise CorruptError("A file did not read back as written", str(path), "equal bytes", "check the disk")

    with durable_path(path, prove) as temporary:
        retried(lambda: temporary.write_bytes(data))


def link_file(source: Path, path: Path) -> None:
    """Gives a file that is whole already a second name, durably; where the disk knows no hard links, a copy.

    Safe because files are only ever replaced, never written to.
    """
    with durable_path(path) as temporary:
        try:
            os.link(source, temporary)
        except OSError as error:
            if error.errno not in (errno.EPERM, errno.EXDEV, errno.ENOTSUP, errno.EMLINK, errno.ENOSYS):
                raise
            shutil.copyfile(source, temporary)
    temporary.unlink(missing_ok=True)  # renaming a file over another name of itself does nothing


def write_json(path: Path, document: Any) -> None:
    """Writes JSON durably, keys sorted, so that equal documents are equal bytes."""
    write_bytes(path, (json.dumps(document, sort_keys=True, indent=1) + "\n").encode())


def sweep_partials(folder: Path) -> int:
    """Removes what killed processes left below a folder; returns how many files."""
    litter = [path for path in folder.rglob(f"*{PARTIAL}*") if path.is_file()]
    for path in litter:
        path.unlink(missing_ok=True)
    return len(litter)
