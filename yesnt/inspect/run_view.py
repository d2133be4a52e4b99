"""The driver of a shot, seen from any machine with the output folder: its lease, its state file, its submission."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yesnt.inspect.status_memory import StatusMemory
from yesnt.io.lease import LeaseState, Observer
from yesnt.io.output import DRIVER, LOOK_SECONDS, OutputFolder
from yesnt.runtime.control.submission import Submission, find_submission

ACTIVE = ("running", "paused", "silent")


@dataclass(frozen=True)
class RunView:
    """State of the last run of a shot.

    Attributes:
        state: `none` (there was none), `queued` (submitted, not begun), `running`, `paused`, `silent` (a driver of
            another host holds the lease and gives no sign of life), `died` (its process is gone, the run is not
            over), `ended`, `failed` or `cancelled`.
        run: identifier of the run, or of the submission that has not begun; what commands are addressed to.
        submission: identifier of the submission; "" if the user started the driver.
        job: what the batch system calls it, or where its driver was started.
        by: who paused or submitted it.
        host: of the driver.
        pid: of the driver.
        began: seconds since the epoch, by the driver's clock.
        shortages: stage ("" for all) -> what it waits for.
        blocked_hosts: host -> why it gets no more tasks.
        dashboard: address of Dask's dashboard.
        exit_status: of a run that is over.
        error: of a run that failed.
    """

    state: str = "none"
    run: str = ""
    submission: str = ""
    job: str = ""
    by: str = ""
    host: str = ""
    pid: int = 0
    began: float = 0.0
    shortages: dict[str, str] = field(default_factory=dict)
    blocked_hosts: dict[str, str] = field(default_factory=dict)
    dashboard: str = ""
    exit_status: int | None = None
    error: str = ""

    @property
    def active(self) -> bool:
        """Whether a driver holds the job."""
        return self.state in ACTIVE

    @property
    def over(self) -> bool:
        """Whether nothing more is to be expected of the run."""
        return not self.active and self.state != "queued"


def look(output: OutputFolder, patience: float = LOOK_SECONDS) -> RunView:
    """The state of the driver; reads small files only and writes nothing.

    Args:
        output: the output folder.
        patience: seconds that a driver of another host is watched for a sign of life.
    """
    document, submission = _read_state(output), find_submission(output)
    lease = _watch(output, patience)
    if lease is None:
        return _without_driver(document, submission)
    state, holder = lease
    view = _of_document(document, submission) if document.get("run") == holder.nonce else RunView(run=holder.nonce)
    owner = {} if holder.owner is None else {"host": holder.owner.host, "pid": holder.owner.pid}
    return _changed(view, run=holder.nonce, state=state or view.state.replace("none", "running"), **owner)


def look_at_run(path: Path) -> RunView:
    """The state of the driver of a job file or its folder; `none` if the job file cannot be read."""
    run = StatusMemory.of(path).run
    return RunView() if run is None else look(OutputFolder(run.parent))


def _watch(output: OutputFolder, patience: float) -> tuple[str, LeaseState] | None:
    """Who holds the lease, and "" or what is known of a holder that does not work."""
    observer, began = Observer(output.leases, DRIVER), time.monotonic()
    while True:
        vacant, holder = observer.vacant(), observer.state
        if holder is None:
            return None
        if vacant or observer.certain or time.monotonic() - began >= patience:
            return ("died" if vacant else "" if observer.certain else "silent"), holder
        time.sleep(0.1)


def _without_driver(document: dict[str, Any], submission: Submission | None) -> RunView:
    if submission is not None and document.get("submission") != submission.id:
        queued = RunView("queued", submission.id, submission.id, submission.job, submission.by, began=submission.time)
        return queued if submission.exit_status is None else _changed(
            queued, state="failed", exit_status=submission.exit_status, error="see `yesnt logs SHOT`"
        )  # fmt: skip
    if not document:
        return RunView()
    view = _of_document(document, submission)
    return _changed(view, state="died", error="the driver ended without a word") if view.active else view


def _of_document(document: dict[str, Any], submission: Submission | None) -> RunView:
    known = {name: document[name] for name in RunView.__dataclass_fields__ if name in document}
    job = submission.job if submission is not None and submission.id == document.get("submission") else ""
    return RunView(**{**known, "job": job})


def _changed(view: RunView, **facts: Any) -> RunView:
    return RunView(**{**vars(view), **facts})


def _read_state(output: OutputFolder) -> dict[str, Any]:
    try:
        document = json.loads(output.run_state.read_text())
        return document if isinstance(document, dict) else {}
    except (OSError, ValueError):
        return {}
