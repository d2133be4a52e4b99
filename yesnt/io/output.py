"""Where a job's results lie (contract.md, "What comes out"), and the lock that keeps a second driver out."""

from __future__ import annotations

import fcntl
import json
import os
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId


@dataclass(frozen=True)
class OutputFolder:
    """Paths below a job's output folder."""

    root: Path

    @classmethod
    def of(cls, job: Job) -> OutputFolder:
        """The output folder of a job; relative names start at the job file's folder."""
        return cls(Path(job.root) / os.path.expanduser(job.shot.output))

    @property
    def store(self) -> Path:
        """The frame store."""
        return self.root / "store.zarr"

    @property
    def exr(self) -> Path:
        """Folder of the EXR sequence."""
        return self.root / "exr"

    @property
    def run(self) -> Path:
        """Folder of everything about the run: records, events, logs, report, preview."""
        return self.root / "run"

    @property
    def records(self) -> Path:
        """Folder of the commit records."""
        return self.run / "records"

    @property
    def dead(self) -> Path:
        """Folder of the marks of frames that killed their workers."""
        return self.run / "dead"

    @property
    def events(self) -> Path:
        """Event log, one JSON object a line."""
        return self.run / "events.jsonl"

    def exr_path(self, name: str, frame: int) -> Path:
        """The delivered file of a frame."""
        return self.exr / f"{name}.{frame:04d}.exr"

    @property
    def segments(self) -> Path:
        """Folder of the preview video's segments while frames arrive, in a folder named after their stage."""
        return self.run / "segments"

    def segment_paths(self, stage: StageId, number: int) -> tuple[Path, Path]:
        """One segment of the preview video, and its frames as a strip for the contact sheet."""
        stem = self.segments / str(stage) / f"{number:05d}"
        return stem.with_suffix(".mp4"), stem.with_suffix(".png")

    def log_path(self, stage: StageId | str, frame: int) -> Path:
        """The log of one frame of one stage."""
        return self.run / "logs" / str(stage) / f"{frame:04d}.log"

    def check(self, needed_bytes: int) -> None:
        """Refuses a folder that cannot be written or has too little room; writes nothing.

        Raises:
            JobError: as said.
        """
        folder = self.root
        while not folder.exists():
            folder = folder.parent
        if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            raise JobError(
                "The output folder cannot be written",
                str(folder),
                "write permission",
                "set `output:` to another folder",
            )
        free = shutil.disk_usage(folder).free
        if free < needed_bytes:
            raise JobError(
                f"The output folder has {free / 1e9:.2f} GB free", str(folder), f"about {needed_bytes / 1e9:.2f} GB",
                "free some, or set `output:` to another disk",
            )  # fmt: skip

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Holds the folder for one driver; the kernel lets go when the process ends, however it ends.

        Raises:
            JobError: another driver runs this job; says which.
        """
        self.run.mkdir(parents=True, exist_ok=True)
        with self._lock_file.open("a+") as stream:
            self._take(stream)
            stream.truncate(0)
            stream.write(json.dumps({"host": platform.node(), "pid": os.getpid()}))
            stream.flush()
            yield

    def refuse_if_running(self) -> None:
        """Refuses a job that another driver runs, without taking the lock and without writing anything.

        Raises:
            JobError: as said.
        """
        if self._lock_file.exists():
            with self._lock_file.open("a+") as stream:
                self._take(stream)

    @property
    def _lock_file(self) -> Path:
        return self.run / "driver.lock"

    def _take(self, stream: TextIO) -> None:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            stream.seek(0)
            owner = stream.read() or "another process"
            raise JobError(
                f"This job is being run already by {owner}",
                str(self._lock_file),
                "one driver a job",
                "wait for it, or stop it",
            ) from error
