"""The command line and the shell lines that start workers on another machine."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from yesnt.runtime.cluster.drain import DRAIN_AT
from yesnt.runtime.cluster.worker_settings import WORKER_ENVIRONMENT
from yesnt.runtime.launchers.profile import Started

WORKER_MODULE = "yesnt.runtime.cluster.worker"

DEATH_SECONDS = 90
"""A worker that has lost the scheduler for this long ends, so that nothing is left of a driver that was killed."""


@dataclass(frozen=True)
class WorkerGroup:
    """Workers that start together: a job, a host, a pod.

    Attributes:
        name: unique in the run; with several processes, theirs get a number behind it.
        pool: the resource that each offers.
        processes: how many, of one thread each.
        memory: limit of each in bytes.
    """

    name: str
    pool: str
    processes: int
    memory: int


def worker_options(profile: Started, group: WorkerGroup) -> list[str]:
    """Options of `dask worker` beside the scheduler's address and the certificates."""
    options = [
        "--name", group.name, "--nworkers", str(group.processes), "--nthreads", "1", "--nanny",
        "--memory-limit", str(group.memory), "--resources", f"{group.pool}=1", "--protocol", "tls://",
        "--death-timeout", str(DEATH_SECONDS), "--no-dashboard", "--preload", "yesnt.runtime.cluster.drain",
    ]  # fmt: skip
    if profile.interface:
        options += ["--interface", profile.interface]
    if profile.scratch:
        options += ["--local-directory", profile.scratch]
    return options


def certificate_options(certificate: Path | str, key: Path | str) -> list[str]:
    """Options of `dask worker` that name certificate files."""
    return ["--tls-ca-file", str(certificate), "--tls-cert", str(certificate), "--tls-key", str(key)]


def python_of(profile: Started) -> str:
    """The Python that runs the workers."""
    return profile.python or sys.executable


def set_up_lines(profile: Started, more: Mapping[str, str] | None = None) -> list[str]:
    """Shell lines before the worker's command: environment, then what the site asks for."""
    variables = {**WORKER_ENVIRONMENT, **profile.environment, **(more or {})}
    return [*(f"export {name}={shlex.quote(value)}" for name, value in variables.items()), *profile.setup]


def drain_line(seconds: int, stagger: int) -> str:
    """The bash line that says when a worker takes its last task; workers that start together end apart."""
    spread = f" - RANDOM % {stagger}" if stagger > 0 else ""
    return f"export {DRAIN_AT}=$(( $(date +%s) + {seconds}{spread} ))"
