"""Cluster profiles: a YAML file that a site writes once (`--cluster farm.yaml`), one model for each kind of cluster."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, ByteSize, ConfigDict, Field, StringConstraints, model_validator

_UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86400}


def seconds_of(text: object) -> int:
    """A duration in seconds: `90s`, `30m`, `4h`, `2d`, `04:00:00` or Slurm's `1-12:00:00`.

    Raises:
        ValueError: another form; a bare number is refused, since Slurm reads minutes and Dask seconds.
    """
    if isinstance(text, int) and not isinstance(text, bool):
        return text
    found = re.fullmatch(r"(\d+)([smhd])", str(text))
    if found:
        return int(found[1]) * _UNITS[found[2]]
    clock = re.fullmatch(r"(?:(\d+)-)?(\d+):(\d\d):(\d\d)", str(text))
    if clock:
        days, hours, minutes, seconds = (int(part or 0) for part in clock.groups())
        return ((days * 24 + hours) * 60 + minutes) * 60 + seconds
    raise ValueError(f"{text!r} is no duration; write 90s, 30m, 4h, 04:00:00 or 1-12:00:00")


Word: TypeAlias = Annotated[str, StringConstraints(min_length=1, pattern=r"^[^\n]*$")]
Duration: TypeAlias = Annotated[int, BeforeValidator(seconds_of), Field(ge=1)]
Count: TypeAlias = Annotated[int, Field(ge=1, le=10_000)]


class Part(BaseModel):
    """A part of a profile: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Local(Part):
    """Workers on this machine, for one run.

    Attributes:
        workers: processes, one thread each.
        memory: limit of a worker in bytes; 0: all memory divided by the workers.
    """

    kind: Literal["local"]
    workers: Count = 2
    memory: ByteSize = ByteSize(0)


class Attach(Part):
    """A scheduler that is running already.

    Attributes:
        address: `tls://HOST:PORT`, or plain TCP on this machine.
        ca_file: authority that signed the scheduler's certificate; absent, like the next two: Dask's configuration.
        cert_file: our certificate.
        key_file: its private key.
    """

    kind: Literal["attach"]
    address: Annotated[Word, StringConstraints(pattern=r"^(tls|tcp)://")]
    ca_file: Word | None = None
    cert_file: Word | None = None
    key_file: Word | None = None


class Started(Part):
    """What all clusters share whose workers the product starts on other machines.

    Attributes:
        memory: limit of a worker, as `4GiB`.
        python: the Python on the workers' machines that has the product; absent: this one's path.
        setup: shell lines that run before a worker starts, such as `module load cuda`.
        environment: variables of the workers.
        interface: network interface that the scheduler listens on, such as `ib0`.
        host: address under which workers reach the scheduler, instead of an interface.
        scratch: folder for Dask's temporary files on the workers.
        decompose_on: `cpu`: backends that are made for a GPU run on CPU workers too.
    """

    memory: ByteSize = ByteSize(4 << 30)
    python: Word | None = None
    setup: tuple[Word, ...] = ()
    environment: dict[Word, str] = {}
    interface: Word | None = None
    host: Word | None = None
    scratch: Word | None = None
    decompose_on: Literal["gpu", "cpu"] = "gpu"

    @model_validator(mode="after")
    def _one_address(self) -> Any:
        if self.interface and self.host:
            raise ValueError("`interface` and `host` exclude one another")
        return self


class SshGpu(Part):
    """GPU workers over SSH: one process for each GPU.

    Attributes:
        hosts: number of GPUs by host; they are numbered from 0.
        memory: limit of a worker.
    """

    hosts: dict[Word, Count] = Field(min_length=1)
    memory: ByteSize = ByteSize(16 << 30)


class Ssh(Started):
    """Workers on machines that one may log in to.

    Attributes:
        hosts: number of workers by host, as `ssh` knows it.
        command: the SSH client and its options.
        gpu: GPU workers.
    """

    kind: Literal["ssh"]
    hosts: dict[Word, Count] = Field(min_length=1)
    command: tuple[Word, ...] = ("ssh", "-o", "BatchMode=yes", "-o", "ServerAliveInterval=15")
    gpu: SshGpu | None = None


class SlurmGpu(Part):
    """GPU workers of a Slurm cluster: one job and one process for each GPU.

    Attributes:
        workers: how many.
        type: of GPU, as `--gres=gpu:TYPE:1` names it; absent: any.
        partition: absent: the profile's.
        memory: limit of a worker.
        walltime: absent: the profile's.
    """

    workers: Count = 1
    type: Word | None = None
    partition: Word | None = None
    memory: ByteSize = ByteSize(16 << 30)
    walltime: Duration | None = None


class Slurm(Started):
    """Jobs of a Slurm cluster.

    Attributes:
        mode: `jobs`: a job for each worker group, submitted from where the run is; `allocation`: `yesnt submit` asks
            for one job, and scheduler, driver and workers live inside it.
        workers: CPU workers in all.
        workers_per_job: processes that share a job.
        partition: absent: Slurm's default.
        account: to charge.
        walltime: of a job; absent: as dask-jobqueue is configured, else 30 minutes.
        drain: how long before the end of its job a worker takes no more tasks; absent: 5 minutes, or a fifth of the
            walltime if that is less.
        options: further options of sbatch, such as `--qos=high`.
        gpu: GPU workers.
    """

    kind: Literal["slurm"]
    mode: Literal["jobs", "allocation"] = "jobs"
    workers: Count = 2
    workers_per_job: Count = 1
    partition: Word | None = None
    account: Word | None = None
    walltime: Duration | None = None
    drain: Duration | None = None
    options: tuple[Annotated[Word, StringConstraints(pattern=r"^-")], ...] = ()
    gpu: SlurmGpu | None = None

    @model_validator(mode="after")
    def _leaves_time(self) -> Any:
        if self.drain is not None and self.walltime is not None and self.drain >= self.walltime:
            raise ValueError("`drain` is as long as `walltime`: a worker would never take a task")
        if self.mode == "allocation" and self.gpu is not None:
            raise ValueError("`mode: allocation` has no GPU pool; use `mode: jobs`")
        return self


class KubernetesGpu(Part):
    """GPU workers of a Kubernetes cluster: one pod and one process for each GPU.

    Attributes:
        workers: how many.
        resource: name of the GPU resource.
        memory: request and limit of a pod.
        image: absent: the profile's.
        node_selector: labels of their nodes.
        tolerations: as in a pod's specification.
    """

    workers: Count = 1
    resource: Word = "nvidia.com/gpu"
    memory: ByteSize = ByteSize(16 << 30)
    image: Word | None = None
    node_selector: dict[Word, str] = {}
    tolerations: tuple[dict[Word, str], ...] = ()


class Volume(Part):
    """A shared folder that every pod mounts under the same path as the machine that runs the driver.

    Attributes:
        path: where it is mounted.
        claim: a PersistentVolumeClaim; or
        nfs: `SERVER:/PATH`; or
        host_path: a folder of the nodes.
    """

    path: Annotated[Word, StringConstraints(pattern=r"^/")]
    claim: Word | None = None
    nfs: Annotated[Word, StringConstraints(pattern=r"^[^:]+:/")] | None = None
    host_path: Annotated[Word, StringConstraints(pattern=r"^/")] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Any:
        if sum(source is not None for source in (self.claim, self.nfs, self.host_path)) != 1:
            raise ValueError("a volume has exactly one of `claim`, `nfs` and `host_path`")
        return self


class Kubernetes(Started):
    """Pods of a Kubernetes cluster that runs Dask's operator.

    Attributes:
        image: that every pod runs; docker/ holds its recipe.
        workers: CPU workers, a pod each.
        namespace: absent: kubectl's.
        context: of kubectl's configuration; absent: the current one.
        volumes: shared folders.
        scheduler_nodes: labels of the nodes that may run the scheduler; they must not be preemptible.
        node_selector: labels of the workers' nodes.
        tolerations: of the workers.
        image_pull_secrets: names of secrets.
        user: number of the user that pods run as; absent: the user's who starts the run, whose folders they write.
        group: number of the group; absent: the user's.
        gpu: GPU workers.
    """

    kind: Literal["kubernetes"]
    image: Word
    workers: Count = 2
    namespace: Word | None = None
    context: Word | None = None
    volumes: tuple[Volume, ...] = Field(min_length=1)
    scheduler_nodes: dict[Word, str] = {}
    node_selector: dict[Word, str] = {}
    tolerations: tuple[dict[Word, str], ...] = ()
    image_pull_secrets: tuple[Word, ...] = ()
    user: Annotated[int, Field(ge=0)] | None = None
    group: Annotated[int, Field(ge=0)] | None = None
    gpu: KubernetesGpu | None = None


Profile: TypeAlias = Local | Attach | Ssh | Slurm | Kubernetes
"""A validated profile."""

MODELS: dict[str, type[Local] | type[Attach] | type[Ssh] | type[Slurm] | type[Kubernetes]] = {
    "local": Local, "attach": Attach, "ssh": Ssh, "slurm": Slurm, "kubernetes": Kubernetes,
}  # fmt: skip
"""The model of each kind."""
