"""A run that was handed over: the driver is a process of its own, here or in a batch system."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from yesnt.io.commands import own_name
from yesnt.io.durable import write_json
from yesnt.io.output import OutputFolder

VARIABLE = "YESNT_SUBMISSION"
"""Environment variable of the driver of a submission; commands may be addressed to it before the run begins."""


@dataclass(frozen=True)
class Submission:
    """What was handed over.

    Attributes:
        id: the product's name of it, `NAME-1a2b3c4d`.
        cluster: as the user named it.
        job: the batch system's name of it, or host and process of a local driver.
        by: user and host.
        time: seconds since the epoch, for people.
        command: arguments of the driver.
        exit_status: of a driver that ended before its run began, for example because the job file is wrong.
    """

    id: str
    cluster: str
    job: str
    by: str
    time: float
    command: tuple[str, ...]
    exit_status: int | None = None


def submission_of_this_process() -> str:
    """Identifier of the submission that started this process; "" if none did."""
    return os.environ.get(VARIABLE, "")


def new_submission_id(name: str) -> str:
    """An identifier that no other submission has."""
    return f"{name}-{uuid.uuid4().hex[:8]}"


def driver_command(identifier: str, arguments: Sequence[str]) -> list[str]:
    """The command of a driver, with which it is known as that submission's."""
    return ["/usr/bin/env", f"{VARIABLE}={identifier}", sys.executable, "-m", "yesnt", "run", *arguments]


def start_detached(output: OutputFolder, identifier: str, arguments: Sequence[str]) -> str:
    """Starts a driver on this machine that outlives this process and its terminal; returns where it runs."""
    command = driver_command(identifier, arguments)
    append = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    files = [
        (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
        (os.POSIX_SPAWN_OPEN, 1, str(output.driver_log), append, 0o644),
        (os.POSIX_SPAWN_DUP2, 1, 2),
    ]
    pid = os.posix_spawn(command[0], command, os.environ, file_actions=files, setsid=True)
    return f"{platform.node()} pid {pid}"


def keep(output: OutputFolder, submission: Submission) -> None:
    """Writes down what was handed over, for `status` and for commands from other machines."""
    output.run.mkdir(parents=True, exist_ok=True)
    write_json(output.submission, asdict(submission))


def note_end(output: OutputFolder, status: int) -> None:
    """Writes down that the driver of a submission has ended; called by that driver itself."""
    submission = find_submission(output)
    if submission is not None and submission.id == submission_of_this_process():
        keep(output, replace(submission, exit_status=status))


def made_now(identifier: str, cluster: str, job: str, command: Sequence[str]) -> Submission:
    """A submission of this user at this time."""
    return Submission(identifier, cluster, job, own_name(), time.time(), tuple(command))


def find_submission(output: OutputFolder) -> Submission | None:
    """The last submission of an output folder; None if there is none that can be read."""
    try:
        document = json.loads(Path(output.submission).read_text())
        return Submission(**{**document, "command": tuple(document["command"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None
