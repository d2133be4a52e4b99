"""Folders of published weights: what they must hold, and their digest."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from yesnt.core.errors import JobError

_WHOLE_BYTES = 64 << 20
"""A file of at most this size is hashed whole."""

_PROBES, _PROBE_BYTES = 64, 1 << 18
"""Of a larger one so many blocks of this size, evenly spread, and its length: `plan` must not read 56 GB."""

_HASHED = (".safetensors", ".json", ".pt", ".jit")


@dataclass(frozen=True)
class Published:
    """A checkpoint as its authors publish it.

    Attributes:
        title: what it is called.
        source: where it is published.
        files: relative paths that must exist; a tuple means any one of them.
    """

    title: str
    source: str
    files: tuple[str | tuple[str, ...], ...]

    def check(self, folder: Path) -> None:
        """Refuses a folder that lacks a file.

        Raises:
            JobError: naming every absent file.
        """
        absent = [" or ".join(choice) for choice in self._choices() if not any((folder / f).is_file() for f in choice)]
        if absent:
            raise JobError(
                f"the folder lacks {', '.join(absent)} of {self.title}",
                str(folder),
                "the layout in which it is published, as safetensors",
                f"download {self.source} into this folder",
            )

    def digest(self, folder: Path) -> str:
        """SHA-256 over names and contents of the weights and configurations, hexadecimal."""
        whole = hashlib.sha256()
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _HASHED):
            whole.update(path.relative_to(folder).as_posix().encode() + b"\0")
            whole.update(fingerprint(path))
        return whole.hexdigest()

    def _choices(self) -> tuple[tuple[str, ...], ...]:
        return tuple((f,) if isinstance(f, str) else f for f in self.files)


def fingerprint(path: Path) -> bytes:
    """SHA-256 of a file; of a very large one, of its length and of blocks spread evenly over it."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if size <= _WHOLE_BYTES:
            return hashlib.file_digest(file, "sha256").digest()
        found = hashlib.sha256(str(size).encode())
        for i in range(_PROBES):
            file.seek((size - _PROBE_BYTES) * i // (_PROBES - 1))
            found.update(file.read(_PROBE_BYTES))
        return found.digest()
