"""Where a job's results lie (contract.md, "What comes out"), and the lease that keeps a second driver out."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io.lease import BEAT_SECONDS, Lease, LeaseState, Observer, read_lease, take_lease

DRIVER = "driver"
"""Name of the driver's lease."""

LOOK_SECONDS = 2 * BEAT_SECONDS
"""How long a lease of another host is watched for a sign of life before anything is started."""


@dataclass(frozen=True)
class OutputFolder:
    """Paths below a job's output folder."""

    root: Path

    @classmethod
    def of(cls, job: Job) -> OutputFolder:
        """The output folder of a job; relative names start at the job file's folder."""
        return cls.under(Path(job.root), job.shot.output)

    @classmethod
    def under(cls, root: Path, output: str) -> OutputFolder:
        """The output folder that a job file in a folder names."""
        return cls(root / os.path.expanduser(output))

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
    def ground(self) -> Path:
        """Where the subject stands, in jobs with a set."""
        return self.run / "ground.json"

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
    def baked_light(self) -> Path:
        """The environment map that was baked from the scene."""
        return self.root / "set" / "light.exr"

    @property
    def blender(self) -> Path:
        """Folder of what Blender renders while a frame of the set is made."""
        return self.run / "blender"

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

    def refuse_inputs(self, name: str, frames: Iterable[int], inputs: Iterable[str]) -> None:
        """Refuses a job whose EXRs, store or records would be written over its own inputs; writes nothing.

        Args:
            name: of the shot.
            frames: that are delivered.
            inputs: paths of all input files.

        Raises:
            JobError: as said; names the first such file.
        """
        real = cache(os.path.realpath)
        exrs, own = real(self.exr), tuple(os.path.join(real(folder), "") for folder in (self.store, self.run))
        delivered = {self.exr_path(name, frame).name for frame in frames}
        for path in inputs:
            folder, file = os.path.split(path)
            if (real(folder) == exrs and file in delivered) or os.path.join(real(folder), "").startswith(own):
                raise JobError(
                    "The results would be written over an input", path, "an output folder apart from the inputs",
                    "set `output:` to another folder, or `name:` to another name",
                )  # fmt: skip

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

    @property
    def run_state(self) -> Path:
        """State of the run, written by its driver."""
        return self.run / "state.json"

    @property
    def submission(self) -> Path:
        """The last submission: what was handed over to which cluster."""
        return self.run / "submission.json"

    @property
    def driver_log(self) -> Path:
        """What the driver of a submission prints."""
        return self.run / "driver.log"

    @property
    def commands(self) -> Path:
        """Folder of commands that wait for the driver."""
        return self.run / "control"

    @property
    def leases(self) -> Path:
        """Folder of the driver's lease."""
        return self.run / "leases"

    @property
    def task_leases(self) -> Path:
        """Folder of the leases of the tasks under way."""
        return self.leases / "tasks"

    @contextmanager
    def lock(self, taken_over: Callable[[LeaseState], None] = lambda state: None) -> Iterator[Lease]:
        """Holds the folder for one driver, on whatever host; one that died without letting go is taken over.

        Args:
            taken_over: called with the state of a driver that is gone.

        Raises:
            JobError: another driver runs this job; says which.
        """
        lease = take_lease(self.leases, DRIVER, patient=False, taken_over=taken_over)
        if lease is None:
            raise self._runs_already(read_lease(self.leases, DRIVER))
        try:
            yield lease
        finally:
            lease.release()

    def refuse_if_running(self) -> None:
        """Refuses a job that another driver runs, without taking the lease and without writing anything.

        Raises:
            JobError: as said.
        """
        observer, began = Observer(self.leases, DRIVER), time.monotonic()
        while not observer.vacant() and time.monotonic() - began < LOOK_SECONDS:
            if observer.certain:
                raise self._runs_already(observer.state)
            time.sleep(0.1)

    def _runs_already(self, state: LeaseState | None) -> JobError:
        owner = "another process" if state is None or state.owner is None else str(state.owner)
        return JobError(
            f"This job is being run already by {owner}", str(self.leases), "one driver a job",
            "wait for it, or stop it with `yesnt cancel SHOT`",
        )  # fmt: skip
