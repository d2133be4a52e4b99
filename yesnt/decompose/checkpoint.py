"""Folders of published weights: required files and digest."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from yesnt.core.errors import JobError

_WHOLE_BYTES = 64 << 20
"""Files up to this size are hashed whole."""

_PROBES, _PROBE_BYTES = 64, 1 << 18
"""A larger file is hashed by its length and this many evenly spaced blocks of this size: `plan` must not read 56 GB."""

_HASHED = (".safetensors", ".json", ".pt", ".jit")
"""Suffixes of weights and configurations."""


@dataclass(frozen=True)
class Published:
    """Layout of a checkpoint as its authors publish it.

    Attributes:
        title: name of the model.
        source: where it is published.
        files: relative paths that must exist; of a tuple, at least one must exist.
    """

    title: str
    source: str
    files: tuple[str | tuple[str, ...], ...]

    def check(self, folder: Path) -> None:
        """Checks that a folder holds every file.

        Raises:
            JobError: files are missing; names every one of them and the source.
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
        """Returns the hexadecimal SHA-256 over names and contents of weights and configurations below `folder`."""
        whole = hashlib.sha256()
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _HASHED):
            whole.update(path.relative_to(folder).as_posix().encode() + b"\0")
            whole.update(fingerprint(path))
        return whole.hexdigest()

    def _choices(self) -> tuple[tuple[str, ...], ...]:
        return tuple((f,) if isinstance(f, str) else f for f in self.files)


def fingerprint(path: Path) -> bytes:
    """Returns the SHA-256 of a file, or of the length and evenly spaced blocks of a file larger than `_WHOLE_BYTES`."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if size <= _WHOLE_BYTES:
            return hashlib.file_digest(file, "sha256").digest()
        found = hashlib.sha256(str(size).encode())
        for i in range(_PROBES):
            file.seek((size - _PROBE_BYTES) * i // (_PROBES - 1))
            found.update(file.read(_PROBE_BYTES))
        return found.digest()
