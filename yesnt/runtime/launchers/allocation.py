"""Scheduler, driver and workers inside one Slurm allocation: the login node holds nothing."""

from __future__ import annotations

import os
import shlex
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from yesnt.core.errors import UsageError
from yesnt.runtime.launchers.certificates import Certificate, CertificateFiles
from yesnt.runtime.launchers.processes import Processes, as_any, shell_words
from yesnt.runtime.launchers.profile import Slurm
from yesnt.runtime.launchers.slurm_commands import NANNY_BYTES, job_class, require_command, slurm_time, working_seconds
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.started import Groups, numbered_groups, worker_logs, workers_elsewhere
from yesnt.runtime.launchers.table import CPU, Running
from yesnt.runtime.launchers.top_up import RUN_UNTIL
from yesnt.runtime.launchers.worker_command import (
    WORKER_MODULE,
    WorkerGroup,
    certificate_options,
    drain_line,
    python_of,
    set_up_lines,
    worker_options,
)

CLUSTER_LOST = 75
"""Exit status of a run that must be started again."""

DRIVER_BYTES = 2 << 30
"""Memory that a driver's job asks for: its scheduler stays below 1 GB at 10,000 frames, and so does the driver."""


class AllocationLauncher:
    """A job step for each worker of the allocation that this process runs in."""

    pools = frozenset({CPU})

    def __init__(self, spec: ClusterSpec) -> None:
        assert isinstance(spec.profile, Slurm)
        self._spec, self._profile = spec, spec.profile

    def check(self) -> None:
        """Looks for the allocation.

        Raises:
            UsageError: this process runs outside of a Slurm job.
        """
        if "SLURM_JOB_ID" not in os.environ:
            raise UsageError(
                "The cluster profile says `mode: allocation`, and this is not inside a Slurm job", "--cluster",
                "a run that `yesnt submit` starts", "use `yesnt submit SHOT --cluster FILE.yaml`, or `mode: jobs`",
            )  # fmt: skip
        require_command("srun")

    def open(self) -> AbstractContextManager[Running]:
        """Starts a step for each worker."""
        return workers_elsewhere(self._profile, self._spec.folder, self._groups, shared=True)

    def _groups(self, address: str, certificate: Certificate, files: CertificateFiles) -> Groups:
        del certificate
        memory = int(self._profile.memory)

        def command(group: WorkerGroup) -> list[str]:
            """A step of one processor; srun may not take the others of the allocation from the next step."""
            step = ["srun", "--exact", "--nodes=1", "--ntasks=1", "--cpus-per-task=1", f"--mem={_step_memory(memory)}",
                    f"--job-name={group.name}", "--input=none"]  # fmt: skip
            options = worker_options(self._profile, group) + certificate_options(files.certificate, files.key)
            worker = [python_of(self._profile), "-m", WORKER_MODULE, address, *options]
            return [*step, *shell_words([*set_up_lines(self._profile), *_drain_lines()], worker)]

        logs = worker_logs(self._spec.folder)
        return as_any(numbered_groups(CPU, self._spec.workers, 1, memory), Processes(command, logs))


def submission_script(spec: ClusterSpec, command: Sequence[str], log: Path) -> str:
    """The sbatch script of a run's driver; in `mode: allocation` its job holds the workers too.

    When the job's time is nearly over the run ends with status 75, and the job is put back into the queue: it resumes.

    Args:
        spec: a Slurm cluster, without the job's own parts.
        command: starts the driver, such as `yesnt run SHOT --cluster FILE.yaml`.
        log: gets the driver's output.

    Raises:
        UsageError: `drain` leaves no time to work.
        MissingPartError: dask-jobqueue is absent.
    """
    profile = spec.profile
    assert isinstance(profile, Slurm)
    job_class()
    seconds, working = working_seconds(profile)
    directives = {
        "job-name": "yesnt", "partition": profile.partition, "account": profile.account, "time": slurm_time(seconds),
        "output": f'"{log}"', **_size(spec, profile),
    }  # fmt: skip
    lines = [
        "#!/usr/bin/env bash",
        *(f"#SBATCH --{name}={value}" for name, value in directives.items() if value),
        *(f"#SBATCH {option}" for option in ("--open-mode=append", "--requeue", "--no-kill", *profile.options)),
        *set_up_lines(profile),
        f"export {RUN_UNTIL}=$(( $(date +%s) + {working} ))",
        shlex.join(command),
        "status=$?",
        "# Its time is over and work is left: once more from the queue. Other failures are not repeated.",
        f'if [ $status -eq {CLUSTER_LOST} ] && [ "$(date +%s)" -ge "${RUN_UNTIL}" ]; then',
        '  scontrol requeue "$SLURM_JOB_ID"',
        "fi",
        "exit $status",
    ]
    return "\n".join(lines) + "\n"


def _size(spec: ClusterSpec, profile: Slurm) -> dict[str, str]:
    """Tasks and memory of a driver's job."""
    if profile.mode == "jobs":
        return {"ntasks": "1", "cpus-per-task": "1", "mem": f"{DRIVER_BYTES >> 20}M"}
    memory = max(int(profile.memory) + NANNY_BYTES, DRIVER_BYTES)
    return {"ntasks": str(spec.workers + 1), "cpus-per-task": "1", "mem-per-cpu": f"{memory >> 20}M"}


def _step_memory(memory: int) -> str:
    return f"{(memory + NANNY_BYTES) >> 20}M"


def _drain_lines() -> list[str]:
    """Workers drain when the run's own time is over; by the clock of their host."""
    until = os.environ.get(RUN_UNTIL)
    return [] if until is None else [drain_line(max(1, int(float(until) - time.time())), 0)]
