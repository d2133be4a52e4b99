"""Where the tasks of a run go: a kind of cluster, or a profile, with what the command line adds."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from yesnt.core.errors import UsageError
from yesnt.runtime.launchers.read_profile import KINDS, find_profile, parse_profile, profiles_folder, read_profile

if TYPE_CHECKING:
    from yesnt.runtime.launchers.profile import Profile

LOOPBACK = ("tcp://127.", "tcp://localhost", "tcp://[::1]")
"""Addresses that only this machine reaches."""


@dataclass(frozen=True)
class ClusterSpec:
    """Where tasks run.

    Attributes:
        kind: "local", the address of a running scheduler (`tcp://127.0.0.1:8786`, `tls://host:8786`), or the kind of
            the profile.
        workers: CPU workers of a local cluster; of others, their profile says it.
        memory: limit of a local worker in bytes; 0 leaves it to Dask (all memory / workers).
        profile: of a cluster that is neither local nor an address.
        insecure: a scheduler on another machine may be reached without TLS.
        gpu: the job has tasks for GPU workers.
        folder: that all machines see, for certificates and logs; None: the current one.
    """

    kind: str = "local"
    workers: int = 2
    memory: int = 0
    profile: Profile | None = None
    insecure: bool = False
    gpu: bool = False
    folder: Path | None = None

    @property
    def launcher(self) -> str:
        """The row of the launchers' table."""
        return "attach" if "://" in self.kind else self.kind

    def of_job(self, gpu: bool, folder: Path | None) -> ClusterSpec:
        """The same cluster, for a job that has GPU tasks or not, with a folder for its certificates and logs."""
        on_cpu = getattr(self.profile, "decompose_on", "gpu") == "cpu"
        return dataclasses.replace(self, gpu=gpu and not on_cpu, folder=folder)


def read_cluster(name: str, workers: int | None = None, insecure: bool = False) -> ClusterSpec:
    """What `--cluster` and `--workers` name.

    Args:
        name: `local`, `slurm`, an address, a profile's file (`farm.yaml`), or the name of one of the site's profiles.
        workers: in place of the profile's; None: the profile's, or 2.
        insecure: allows plain TCP to another machine.

    Raises:
        UsageError: there is no such cluster, or its profile is wrong.
    """
    path = find_profile(name)
    if path is not None:
        return _of_profile(read_profile(path), str(path), workers, insecure)
    if name == "slurm":  # the cluster's own defaults serve
        return _of_profile(parse_profile({"kind": "slurm"}, "--cluster slurm"), "--cluster slurm", workers, insecure)
    if name in KINDS and name != "local":
        raise UsageError(
            f"The cluster {name!r} needs a profile", f"--cluster {name}", f"a file such as {name}.yaml",
            f"write one (deploy/{name}/ has an example) and give it, or save it as {profiles_folder()}/{name}.yaml",
        )  # fmt: skip
    if name != "local" and "://" not in name:
        raise no_such_kind(name)
    return ClusterSpec(name, workers or 2, insecure=insecure)


def no_such_kind(name: str) -> UsageError:
    """The error of a cluster that is neither a kind, nor a profile, nor an address."""
    return UsageError(
        f"No cluster of the kind {name!r}", "--cluster",
        "local, slurm, a profile such as farm.yaml, tcp://127.0.0.1:PORT or tls://HOST:PORT",
        f"check its spelling; profiles are found by name in {profiles_folder()}, examples are in deploy/",
    )  # fmt: skip


def _of_profile(profile: Profile, where: str, workers: int | None, insecure: bool) -> ClusterSpec:
    """A profile with the command line's number of workers."""
    from yesnt.runtime.launchers.profile import Attach, Local, Ssh

    kind = profile.kind
    if isinstance(profile, Attach):
        return ClusterSpec(profile.address, workers or 2, profile=profile, insecure=insecure)
    if isinstance(profile, Ssh):
        if workers is not None:
            raise UsageError(
                "The hosts of an SSH profile say how many workers each has", f"--workers {workers}", "no --workers",
                f"change `hosts` in {where}",
            )  # fmt: skip
        return ClusterSpec(kind, sum(profile.hosts.values()), profile=profile, insecure=insecure)
    memory = int(profile.memory) if isinstance(profile, Local) else 0
    return ClusterSpec(kind, workers or profile.workers, memory, profile, insecure)
