"""The last answer of `yesnt status`, and what must be unchanged for it to hold.

Nothing heavy is imported here: on a long shot, importing and planning take longer than looking at all files.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.io.file_digests import SETTLED_SECONDS, save_memory
from yesnt.io.record_index import records_fingerprint

_VERSION = 1
_PACKAGE = Path(__file__).parent.parent


@dataclass(frozen=True)
class StatusMemory:
    """The memory of one job.

    Attributes:
        job: the job file.
        run: folder `out/run` of its results; None if the job file cannot be read.
    """

    job: Path
    run: Path | None

    @classmethod
    def of(cls, path: Path) -> StatusMemory:
        """The memory of a job file or its folder."""
        job = path.absolute()
        job = job / "shot.yaml" if job.is_dir() else job
        return cls(job, _run_folder(job))

    def recall(self) -> dict[str, Any] | None:
        """The last answer, or None if something it depends on may have changed."""
        if self.run is None:
            return None
        try:
            document = json.loads(self._file.read_bytes())
            kept: dict[str, Any] = document["answer"]
            paths = document["paths"]
            return kept if document["fingerprint"] == self._fingerprint(paths)[0] else None
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def keep(self, answer: dict[str, Any], files: Iterable[str]) -> None:
        """Remembers an answer that was just computed from these files, from the records and from the marks of death.

        It is not kept if a file has only just changed: it may change again without another time.
        """
        if self.run is None:
            return
        paths = sorted({str(self.job), *files})
        fingerprint, newest = self._fingerprint(paths)
        if time.time_ns() - newest > SETTLED_SECONDS * 1e9:
            save_memory(self._file, {"fingerprint": fingerprint, "paths": paths, "answer": answer})

    @property
    def _file(self) -> Path:
        assert self.run is not None
        return self.run / "status.json"

    def _fingerprint(self, paths: list[str]) -> tuple[str, int]:
        """Changes with every file, record and mark, and with the code; and the time of the newest file."""
        assert self.run is not None
        digest, newest = hashlib.blake2b(f"{_VERSION}".encode(), digest_size=16), 0
        for path in [*paths, *_code()]:
            try:
                found = os.stat(path)
            except OSError:
                digest.update(f"{path} absent\n".encode())
                continue
            newest = max(newest, found.st_mtime_ns, found.st_ctime_ns)
            state = f"{found.st_size} {found.st_mtime_ns} {found.st_ctime_ns} {found.st_ino}"
            digest.update(f"{path} {state}\n".encode())
        for folder in ("records", "dead"):
            digest.update(records_fingerprint(self.run / folder).encode())
        return digest.hexdigest(), newest


def _run_folder(job: Path) -> Path | None:
    import yaml

    try:
        document = yaml.safe_load(job.read_text(encoding="utf-8"))
        output = document.get("output", "out")
        return job.parent / os.path.expanduser(output) / "run"
    except (OSError, ValueError, TypeError, AttributeError, yaml.YAMLError):
        return None


def _code() -> list[str]:
    """The package's own modules: another version may see a frame as stale."""
    return sorted(str(path) for path in _PACKAGE.rglob("*.py"))
