"""The protocol of a launcher, and the table of launchers: a new one is a file and a row."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from yesnt.core.errors import UsageError, YesntError
from yesnt.runtime.launchers.spec import ClusterSpec, no_such_kind

CPU, GPU = "CPU", "GPU"
"""Names of the worker resources; a worker of a pool offers 1 of its own."""

LAUNCHERS = {
    "local": "yesnt.runtime.launchers.local:LocalLauncher",
    "attach": "yesnt.runtime.launchers.attach:AttachLauncher",
    "ssh": "yesnt.runtime.launchers.ssh:SshLauncher",
    "slurm": "yesnt.runtime.launchers.slurm:slurm_launcher",
    "kubernetes": "yesnt.runtime.launchers.kubernetes:KubernetesLauncher",
}
"""The class of each kind of cluster, as `module:class`; or `module:function`; called with a `ClusterSpec`."""


def _no_problem() -> YesntError | None:
    return None


@dataclass(frozen=True)
class Running:
    """A cluster that is up.

    Attributes:
        address: of the scheduler, or Dask's cluster object.
        security: Dask's TLS settings; None: its configuration's.
        dashboard: address of Dask's dashboard on this machine; "": as the scheduler says.
        problem: why the cluster is of no use any more (its workers end as soon as they start); None while it is well.
    """

    address: Any
    security: Any = None
    dashboard: str = ""
    problem: Callable[[], YesntError | None] = _no_problem


class Launcher(Protocol):
    """Starts and ends the workers of a run in one kind of place."""

    pools: frozenset[str]
    """Resources that its workers will offer; empty: unknown, or workers take every task."""

    def check(self) -> None:
        """Refuses what cannot work, before anything is written.

        Raises:
            UsageError: the address is not safe, a program is absent, the profile contradicts itself.
            MissingPartError: an optional package is absent.
        """

    def open(self) -> AbstractContextManager[Running]:
        """Starts scheduler and workers (workers may come later), and ends them."""


def launcher_of(spec: ClusterSpec) -> Launcher:
    """The launcher of a cluster.

    Raises:
        UsageError: the kind is unknown.
    """
    if spec.launcher not in LAUNCHERS:
        raise no_such_kind(spec.kind)
    module, name = LAUNCHERS[spec.launcher].split(":")
    launcher: Launcher = getattr(import_module(module), name)(spec)
    return launcher


def check_cluster(spec: ClusterSpec) -> None:
    """Refuses a cluster that cannot run the job, before anything is written.

    Raises:
        UsageError: unknown kind, unsafe address, or the job needs a resource that no worker will offer.
        MissingPartError: the kind needs an extra that is absent.
    """
    launcher = launcher_of(spec)
    launcher.check()
    if spec.gpu and launcher.pools and GPU not in launcher.pools:
        raise UsageError(
            "The job's decomposition backend is made for a GPU, and the cluster has no GPU workers",
            f"the {spec.kind} profile", "a section `gpu:`",
            "add it, or `decompose_on: cpu` if it is to run on CPU workers all the same (slowly)",
        )  # fmt: skip


@contextmanager
def launched(spec: ClusterSpec) -> Iterator[Running]:
    """Yields the running cluster of a spec."""
    launcher = launcher_of(spec)
    launcher.check()
    with launcher.open() as running:
        yield running
