"""Workers as jobs of a Slurm cluster. dask-jobqueue writes the job scripts, so that a site's configuration of it holds.

Its own `scale` and `adapt` are not used: neither replaces a worker that has reached its lifetime
(dask/dask-jobqueue#691), and `adapt` gives workers back early (dask/dask-jobqueue#701).
"""

from __future__ import annotations

import shlex
from collections.abc import Collection
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from uuid import uuid4

from yesnt.runtime.launchers.certificates import Certificate, CertificateFiles
from yesnt.runtime.launchers.processes import last_lines
from yesnt.runtime.launchers.profile import Slurm, SlurmGpu
from yesnt.runtime.launchers.slurm_commands import (
    cancel,
    job_class,
    jobs_of,
    require_command,
    slurm_memory,
    slurm_time,
    stagger_of,
    submit,
    working_seconds,
)
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
        logs, name = worker_logs(self._spec.folder), f"yesnt-{uuid4().hex[:8]}"
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
