"""Slurm's commands, and what its job scripts say of time and memory."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Collection
from pathlib import Path
from typing import Any

from yesnt.core.errors import MissingPartError, UsageError
from yesnt.runtime.launchers.profile import Slurm, SlurmGpu, seconds_of
from yesnt.runtime.launchers.worker_command import WorkerGroup

COMMAND_SECONDS = 60
DRAIN_SECONDS, STAGGER_SECONDS = 300, 60
NANNY_BYTES = 512 << 20
"""Memory of a job beside its workers' limits: Dask's nanny, which ends a worker before Slurm ends the job."""

ENDED = ("BOOT_FAIL", "CANCELLED", "COMPLETED", "COMPLETING", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY",
         "PREEMPTED", "TIMEOUT")  # fmt: skip
"""States of jobs that Slurm still lists although their processes are gone or on their way out."""


def job_class() -> Any:
    """dask-jobqueue's Slurm job.

    Raises:
        MissingPartError: the package is absent.
    """
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        from dask_jobqueue.slurm import SLURMJob
    except ImportError as error:
        raise MissingPartError(
            "Slurm jobs need dask-jobqueue", str(error), "the extra slurm", "pip install 'yesnt[slurm]'"
        ) from error
    finally:
        # Its import makes Ctrl-C end the process with status 0: it installs handlers of its own.
        for number, handler in handlers.items():
            if signal.getsignal(number) is not handler:
                signal.signal(number, handler)
    return SLURMJob


def require_command(
    name: str, kind: str = "slurm", do: str = "run it on the cluster's login node, or load Slurm's module"
) -> None:
    """Refuses a machine on which a command is absent.

    Args:
        name: of the program.
        kind: of cluster that needs it.
        do: the remedy.

    Raises:
        UsageError: it is not on the search path.
    """
    if shutil.which(name) is None:
        raise UsageError(
            f"The command {name} is not on this machine", f"a cluster of the kind {kind}",
            f"{name} on the search path", do,
        )  # fmt: skip


def submit(script: str, folder: Path) -> str:
    """Hands a script to sbatch; returns the job's number.

    Raises:
        UsageError: Slurm refuses it; quotes its reason.
    """
    done = _command(["sbatch", "--parsable", f"--chdir={folder}"], script)
    if done is None or done.returncode:
        reason = "it does not answer" if done is None else done.stderr.strip()
        raise UsageError(f"Slurm refuses the job ({reason})", "sbatch", "a job that the partition accepts",
                         "correct partition, account, walltime, memory or options of the profile")  # fmt: skip
    return done.stdout.strip().partition(";")[0]


def jobs_of(name: str) -> set[str] | None:
    """Numbers of the user's jobs of a name that wait or run; None if Slurm does not answer."""
    done = _command(["squeue", "--noheader", "--me", f"--name={name}", "--format=%A %T"])
    if done is None or done.returncode:
        return None
    rows = (line.split() for line in done.stdout.splitlines())
    return {row[0] for row in rows if len(row) == 2 and row[1] not in ENDED}


def cancel(numbers: Collection[str]) -> None:
    """Cancels jobs; those that have ended are passed over."""
    if numbers:
        _command(["scancel", *numbers])


def working_seconds(profile: Slurm, gpu: SlurmGpu | None = None) -> tuple[int, int]:
    """Walltime of a job, and when its workers take their last task.

    Raises:
        UsageError: `drain` leaves no time.
    """
    import dask

    job_class()  # its package loads the site's configuration
    given = (gpu and gpu.walltime) or profile.walltime
    seconds = given if given is not None else seconds_of(dask.config.get("jobqueue.slurm.walltime") or "30m")
    drain = profile.drain if profile.drain is not None else min(DRAIN_SECONDS, seconds // 5)
    if drain >= seconds:
        raise UsageError(
            f"A worker would never take a task: `drain` is {drain} s and the walltime {seconds} s",
            "keys drain and walltime of the cluster profile", "a shorter drain", "correct the profile",
        )  # fmt: skip
    return seconds, seconds - drain


def stagger_of(working: int) -> int:
    """Over how many seconds the ends of workers that start together are spread."""
    return min(STAGGER_SECONDS, working // 10)


def slurm_time(seconds: int) -> str:
    """A duration as sbatch reads it."""
    hours, rest = divmod(seconds, 3600)
    return f"{hours:02d}:{rest // 60:02d}:{rest % 60:02d}"


def slurm_memory(group: WorkerGroup) -> str:
    """Memory that a job asks for."""
    return f"{(group.processes * group.memory + NANNY_BYTES) >> 20}M"


def _command(words: list[str], text: str | None = None) -> subprocess.CompletedProcess[str] | None:
    """Runs one of Slurm's commands; None if it does not end in time."""
    try:
        return subprocess.run(
            words, input=text, capture_output=True, text=True, timeout=COMMAND_SECONDS, start_new_session=True,
            env=_environment(),
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return None


def _environment() -> dict[str, str]:
    """This process's environment without the variables of a job that it runs in, which sbatch would read as options."""
    own = ("SLURM_CONF", "SLURM_CLUSTERS")
    return {name: value for name, value in os.environ.items() if not name.startswith("SLURM_") or name in own}
