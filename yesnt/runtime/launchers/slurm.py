"""Workers as jobs of a Slurm cluster. dask-jobqueue writes the job scripts, so that a site's configuration of it holds.

Its own `scale` and `adapt` are not used: neither replaces a worker that has reached its lifetime
(dask/dask-jobqueue#691), and `adapt` gives workers back early (dask/dask-jobqueue#701).
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Collection
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from uuid import uuid4

from yesnt.core.errors import MissingPartError, UsageError
from yesnt.runtime.launchers.certificates import Certificate, CertificateFiles
from yesnt.runtime.launchers.processes import last_lines
from yesnt.runtime.launchers.profile import Slurm, SlurmGpu, seconds_of
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.started import Groups, numbered_groups, worker_logs, workers_elsewhere
from yesnt.runtime.launchers.table import CPU, GPU, Launcher, Running
from yesnt.runtime.launchers.worker_command import (
    WORKER_MODULE,
    WorkerGroup,
    certificate_options,
    drain_line,
    python_of,
    set_up_lines,
    worker_options,
)

COMMAND_SECONDS = 60
DRAIN_SECONDS, STAGGER_SECONDS = 300, 60
NANNY_BYTES = 512 << 20
"""Memory of a job beside its workers' limits: Dask's nanny, which ends a worker before Slurm ends the job."""

ENDED = ("BOOT_FAIL", "CANCELLED", "COMPLETED", "COMPLETING", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY",
         "PREEMPTED", "TIMEOUT")  # fmt: skip
"""States of jobs that Slurm still lists although their processes are gone or on their way out."""


def slurm_launcher(spec: ClusterSpec) -> Launcher:
    """A job for each worker group, or the workers of the allocation that this process runs in."""
    assert isinstance(spec.profile, Slurm)
    if spec.profile.mode == "allocation":
        from yesnt.runtime.launchers.allocation import AllocationLauncher

        return AllocationLauncher(spec)
    return SlurmLauncher(spec)


class SlurmLauncher:
    """A job for each worker group, submitted and replaced from here."""

    def __init__(self, spec: ClusterSpec) -> None:
        assert isinstance(spec.profile, Slurm)
        self._spec, self._profile = spec, spec.profile
        self.pools = frozenset({CPU, GPU} if spec.profile.gpu else {CPU})

    def check(self) -> None:
        """Looks for Slurm's commands and dask-jobqueue.

        Raises:
            UsageError: this machine does not submit to Slurm, or the walltime leaves no time to work.
            MissingPartError: dask-jobqueue is absent.
        """
        for command in ("sbatch", "squeue", "scancel"):
            require_command(command)
        job_class()
        for gpu in (None, self._profile.gpu):
            working_seconds(self._profile, gpu)

    def open(self) -> AbstractContextManager[Running]:
        """Submits the jobs; they may wait in the queue while the run goes on with those that have started."""
        return workers_elsewhere(self._profile, self._spec.folder, self._groups, shared=True)

    def _groups(self, address: str, certificate: Certificate, files: CertificateFiles) -> Groups:
        del certificate
        logs, name = worker_logs(self._spec.folder or Path.cwd()), f"yesnt-{uuid4().hex[:8]}"
        profile = self._profile
        cpu = numbered_groups(CPU, self._spec.workers, profile.workers_per_job, int(profile.memory))
        source = _Jobs(profile, None, address, files, logs, name)
        groups: list[tuple[WorkerGroup, Any]] = [(group, source) for group in cpu]
        if profile.gpu is not None and self._spec.gpu:
            source = _Jobs(profile, profile.gpu, address, files, logs, f"{name}-gpu")
            gpus = numbered_groups(GPU, profile.gpu.workers, 1, int(profile.gpu.memory))
            groups += [(group, source) for group in gpus]
        return groups


class _Jobs:
    """Jobs of one pool; a token is a job's number."""

    def __init__(
        self, profile: Slurm, gpu: SlurmGpu | None, address: str, files: CertificateFiles, logs: Path, name: str
    ) -> None:
        self._profile, self._gpu, self._address = profile, gpu, address
        self._files, self._logs, self._name = files, logs, name

    def start(self, group: WorkerGroup) -> str:
        """Submits a job."""
        return submit(self.script(group), self._logs)

    def script(self, group: WorkerGroup) -> str:
        """The job's script."""
        profile, gpu = self._profile, self._gpu
        seconds, working = working_seconds(profile, gpu)
        # dask-jobqueue puts paths into its script as they are: those with spaces are quoted here.
        stem = self._logs / f"{self._name}-%j"
        directives = [*profile.options, f'--output="{stem}.out"', f'--error="{stem}.err"']
        if gpu is not None:
            directives.append(f"--gres=gpu:{gpu.type}:1" if gpu.type else "--gres=gpu:1")
        options = worker_options(profile, group) + certificate_options(self._files.certificate, self._files.key)
        job = job_class()(
            self._address, name=group.name, job_name=self._name, queue=(gpu and gpu.partition) or profile.partition,
            account=profile.account, walltime=slurm_time(seconds), cores=group.processes, processes=group.processes,
            memory=f"{group.processes * group.memory} B", job_mem=slurm_memory(group),
            python=shlex.quote(python_of(profile)), worker_command=WORKER_MODULE, job_extra_directives=directives,
            worker_extra_args=[shlex.quote(option) for option in options],
            job_script_prologue=[*set_up_lines(profile), drain_line(working, stagger_of(working))],
        )  # fmt: skip
        return str(job.job_script())

    def alive(self, tokens: Collection[str]) -> set[str] | None:
        """Jobs that wait or run; None if Slurm does not answer."""
        return jobs_of(self._name)

    def stop(self, tokens: Collection[str]) -> None:
        """Cancels jobs."""
        cancel(tokens)

    def log_of(self, token: str) -> str:
        """The end of a job's error output."""
        return last_lines(self._logs / f"{self._name}-{token}.err")


def job_class() -> Any:
    """dask-jobqueue's Slurm job.

    Raises:
        MissingPartError: the package is absent.
    """
    try:
        from dask_jobqueue.slurm import SLURMJob
    except ImportError as error:
        raise MissingPartError(
            "Slurm jobs need dask-jobqueue", str(error), "the extra slurm", "pip install 'yesnt[slurm]'"
        ) from error
    return SLURMJob


def require_command(name: str) -> None:
    """Refuses a machine on which a command is absent.

    Raises:
        UsageError: it is not on the search path.
    """
    if shutil.which(name) is None:
        raise UsageError(
            f"The command {name} is not on this machine", "--cluster slurm", "a machine that submits to Slurm",
            "run it on the cluster's login node, or load Slurm's module",
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
    import dask_jobqueue.config  # noqa: F401 - it loads the site's configuration

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
            env={**os.environ, "SLURM_TIME_FORMAT": "standard"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return None
