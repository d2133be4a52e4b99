"""Content digests of files, remembered as long as a file's path, size, times and inode stay the same.

Hashing is linear in bytes: minutes for a long shot. The memory of it lies in the output folder, may be deleted at any
time, and is ignored where it is damaged.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from yesnt.core.errors import JobError
from yesnt.core.parallel import parallel_map

Identity = tuple[int, int, int, int]
"""Size in bytes, time of the last change of the content and of the inode in nanoseconds, inode number."""

READERS = 2
"""Files that are hashed side by side."""

SETTLED_SECONDS = 2.0
"""A file that changed less than this before it was hashed may change again within one tick of its disk's clock: it is
hashed again next time."""

Progress = Callable[[int, int], None]
"""Called with the number of files hashed so far and their total."""


def file_digest(path: Path) -> str:
    """BLAKE2b-128 of a file's bytes, hexadecimal.

    Raises:
        JobError: the file is missing or cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except OSError as error:
        raise _unreadable(path, error) from error


def file_identity(path: str | Path) -> Identity:
    """What changes whenever a file is replaced or rewritten, without reading it.

    Raises:
        JobError: the file is missing.
    """
    try:
        found = os.stat(path)
    except OSError as error:
        raise _unreadable(Path(path), error) from error
    return found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino


class FileDigests:
    """Digests of many files, kept in a JSON file between runs.

    Args:
        memory: that file, `out/run/file_digests.json`; it is written by `save` only.
    """

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        self._known = _load(memory)
        self._used: dict[str, tuple[Identity, str]] = {}
        self._changed = False

    def of(self, paths: Iterable[Path], progress: Progress = lambda done, total: None) -> dict[str, str]:
        """Path -> digest, for every path; only files that are not known by their identity are read.

        Raises:
            JobError: a file is missing or cannot be read.
        """
        found: dict[str, str] = {}
        unknown: list[tuple[str, Identity]] = []
        for path in map(str, paths):
            identity = file_identity(path)
            known = self._known.get(path)
            if known is not None and known[0] == identity:
                found[path] = known[1]
                self._used[path] = known
            else:
                unknown.append((path, identity))
        self._hash(unknown, found, progress)
        return found

    def save(self) -> None:
        """Writes the memory, with the files that were asked for; a folder that cannot be written is no error."""
        if not self._changed and self._used.keys() == self._known.keys():
            return
        document = {"version": 1, "files": {path: [*identity, d] for path, (identity, d) in self._used.items()}}
        save_memory(self._memory, document)

    def _hash(self, unknown: list[tuple[str, Identity]], found: dict[str, str], progress: Progress) -> None:
        now = time.time_ns()
        digests = parallel_map(lambda item: file_digest(Path(item[0])), unknown, READERS)
        for count, ((path, identity), digest) in enumerate(zip(unknown, digests, strict=True), 1):
            found[path] = digest
            if now - max(identity[1], identity[2]) > SETTLED_SECONDS * 1e9:
                self._used[path], self._changed = (identity, digest), True
            progress(count, len(unknown))


def save_memory(path: Path, document: object) -> None:
    """Writes a file that can be rebuilt: not synced, and left out where the folder is absent or refuses."""
    if not path.parent.is_dir():
        return
    temporary = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with suppress(OSError):
        temporary.write_text(json.dumps(document, separators=(",", ":")))
        os.replace(temporary, path)


def _load(memory: Path) -> dict[str, tuple[Identity, str]]:
    try:
        document = json.loads(memory.read_bytes())
        if document["version"] != 1:
            return {}
        rows = document["files"].items()
        return {path: ((row[0], row[1], row[2], row[3]), str(row[4])) for path, row in rows}
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError):
        return {}


def _unreadable(path: Path, error: OSError) -> JobError:
    if isinstance(error, FileNotFoundError):
        return JobError("A file is missing", str(path), "a readable file", "check the path and the frame range")
    # A folder, no permission, a network disk that is gone.
    return JobError(
        f"A file cannot be read ({error.strerror})", str(path), "a readable file", "check what it is and its rights"
    )
