"""What launchers of other machines share: a scheduler here with TLS, worker groups that are topped up."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from yesnt.runtime.launchers.certificates import Certificate, CertificateFiles, certificate_files, make_certificate
from yesnt.runtime.launchers.profile import Started
from yesnt.runtime.launchers.scheduler import Joined, dashboard_address, scheduler_here
from yesnt.runtime.launchers.table import Running
from yesnt.runtime.launchers.top_up import RUN_UNTIL, Source, TopUp, topped_up
from yesnt.runtime.launchers.worker_command import WorkerGroup

Groups = Sequence[tuple[WorkerGroup, Source[Any]]]


@contextmanager
def workers_elsewhere(
    profile: Started,
    folder: Path | None,
    groups_of: Callable[[str, Certificate, CertificateFiles], Groups],
    shared: bool,
) -> Iterator[Running]:
    """Yields a cluster whose scheduler runs here and whose workers run on other machines.

    Args:
        profile: of the cluster.
        folder: that all machines see, for certificates and logs; None: the current one.
        groups_of: returns the wanted groups for a scheduler's address and the run's certificate.
        shared: whether the workers read the certificate's files from the folder; else the files stay on this machine.
    """
    certificate = make_certificate()
    log = worker_logs(folder) / "launcher.log"
    with (
        certificate_files(certificate, (folder or Path.cwd()) if shared else None) as files,
        scheduler_here(certificate, profile.interface, profile.host) as cluster,
    ):
        groups = groups_of(cluster.scheduler_address, certificate, files)
        top_up = TopUp(groups, Joined(cluster), log, partial(_lose, cluster), _ends_at())
        with topped_up(top_up):
            yield Running(cluster, certificate.security(), dashboard_address(cluster), top_up.problem)


def worker_logs(folder: Path | None) -> Path:
    """The folder of the workers' logs, made if need be; of the current folder, if none is given."""
    logs = (folder or Path.cwd()) / "workers"
    logs.mkdir(parents=True, exist_ok=True)
    return logs


def numbered_groups(name: str, workers: int, per_group: int, memory: int) -> list[WorkerGroup]:
    """Worker groups `cpu-0`, `cpu-1`, ... of one pool; the last may be smaller.

    Args:
        name: of the pool.
        workers: processes in all.
        per_group: processes of a group.
        memory: limit of a process in bytes.
    """
    sizes = [min(per_group, workers - first) for first in range(0, workers, per_group)]
    return [WorkerGroup(f"{name.lower()}-{i}", name, size, memory) for i, size in enumerate(sizes)]


def _ends_at() -> float | None:
    """When a driver in a job of its own must end, by the monotonic clock."""
    until = os.environ.get(RUN_UNTIL)
    return None if until is None else time.monotonic() + float(until) - time.time()


def _lose(cluster: Any) -> None:
    """Closes the scheduler, so that the driver notices that the cluster is lost."""
    with suppress(TimeoutError, OSError):
        cluster.close(timeout=10)
