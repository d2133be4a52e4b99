"""Workers on machines that one may log in to.

The user's own `ssh` starts them, so that its configuration (keys, agents, jump hosts, host names) holds; Dask's
SSHCluster uses another client, which reads only a part of it, and does not replace a worker that is lost.
The certificate travels over the connection, and the workers end with it.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import Any

from yesnt.core.errors import UsageError
from yesnt.runtime.cluster.worker import FROM_STDIN
from yesnt.runtime.launchers.certificates import Certificate, CertificateFiles
from yesnt.runtime.launchers.processes import Processes
from yesnt.runtime.launchers.profile import Ssh
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.started import Groups, worker_logs, workers_elsewhere
from yesnt.runtime.launchers.table import CPU, GPU, Running
from yesnt.runtime.launchers.worker_command import (
    WORKER_MODULE,
    WorkerGroup,
    python_of,
    set_up_lines,
    worker_options,
)


class SshLauncher:
    """A connection for each host, and for each GPU."""

    def __init__(self, spec: ClusterSpec) -> None:
        assert isinstance(spec.profile, Ssh)
        self._spec, self._profile = spec, spec.profile
        self.pools = frozenset({CPU, GPU} if spec.profile.gpu else {CPU})

    def check(self) -> None:
        """Looks for the SSH client.

        Raises:
            UsageError: it is absent, or a host would be read as one of its options.
        """
        import shutil

        if shutil.which(self._profile.command[0]) is None:
            raise UsageError(
                f"The SSH client {self._profile.command[0]!r} is not on this machine", "key command of the profile",
                "a program", "install OpenSSH's client, or correct `command`",
            )  # fmt: skip
        gpu_hosts = self._profile.gpu.hosts if self._profile.gpu else {}
        for host in (*self._profile.hosts, *gpu_hosts):
            if host.startswith("-"):
                raise UsageError(
                    f"The host {host!r} looks like an option of ssh", "key hosts of the profile", "a host name"
                )

    def open(self) -> AbstractContextManager[Running]:
        """Connects to all hosts; those that do not answer are tried again while the others work."""
        return workers_elsewhere(self._profile, self._spec.folder, self._groups, shared=False)

    def _groups(self, address: str, certificate: Certificate, files: CertificateFiles) -> Groups:
        del files
        logs = worker_logs(self._spec.folder)
        line = json.dumps(asdict(certificate))
        profile, groups = self._profile, list[tuple[WorkerGroup, Any]]()
        for i, (host, count) in enumerate(profile.hosts.items()):
            source = Processes(self._command(host, address), logs, line)
            groups.append((WorkerGroup(f"cpu-{i}", CPU, count, int(profile.memory)), source))
        if profile.gpu is not None and self._spec.gpu:
            devices = [(host, device) for host, count in profile.gpu.hosts.items() for device in range(count)]
            for i, (host, device) in enumerate(devices):
                visible = {"CUDA_VISIBLE_DEVICES": str(device)}
                source = Processes(self._command(host, address, visible), logs, line)
                groups.append((WorkerGroup(f"gpu-{i}", GPU, 1, int(profile.gpu.memory)), source))
        return groups

    def _command(self, host: str, address: str, variables: Mapping[str, str] | None = None) -> Any:
        """A function from a group to the words that start it on a host."""
        profile = self._profile

        def command(group: WorkerGroup) -> list[str]:
            options = worker_options(profile, group)
            worker = [python_of(profile), "-m", WORKER_MODULE, FROM_STDIN, address, *options]
            lines = ["set -e", *set_up_lines(profile, variables), f"exec {shlex.join(worker)}"]
            # The login shell of the host may be another one than bash.
            return [*profile.command, host, f"exec bash -c {shlex.quote(chr(10).join(lines))}"]

        return command
