"""Scheduler and workers as pods of a Kubernetes cluster that runs Dask's operator.

The user's own `kubectl` creates, reaches and deletes them, so that its contexts and log-in plugins hold. The operator
replaces workers that are lost; a scheduler that is lost ends the run, which resumes when it is started again.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO
from uuid import uuid4

from yesnt.core.errors import ClusterLostError, MissingPartError, UsageError
from yesnt.runtime.launchers.certificates import make_certificate
from yesnt.runtime.launchers.manifests import DASHBOARD_PORT, PORT, Manifest, manifests, scheduler_address
from yesnt.runtime.launchers.operator_schema import check_manifest
from yesnt.runtime.launchers.profile import Kubernetes
from yesnt.runtime.launchers.slurm_commands import require_command
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.started import worker_logs
from yesnt.runtime.launchers.table import CPU, GPU, Running

COMMAND_SECONDS = 60
READY_SECONDS = 900
"""A scheduler that is not ready by then will not be: the image cannot be pulled, or no node may run it."""

POLL_SECONDS = 2.0
FORWARD_SECONDS = 20.0


class KubernetesLauncher:
    """A DaskCluster, and a DaskWorkerGroup for GPUs."""

    def __init__(self, spec: ClusterSpec) -> None:
        assert isinstance(spec.profile, Kubernetes)
        self._spec, self._profile = spec, spec.profile
        self.pools = frozenset({CPU, GPU} if spec.profile.gpu else {CPU})

    def check(self) -> None:
        """Looks for kubectl, and validates the manifests.

        Raises:
            UsageError: kubectl is absent, or the operator's schema refuses what the profile makes.
            MissingPartError: dask-kubernetes is absent.
        """
        require_command("kubectl", "kubernetes", "install kubectl, and give it a context of your cluster")
        try:
            for manifest in self._manifests("yesnt-check"):
                check_manifest(manifest)
        except ImportError as error:
            raise MissingPartError(
                "Manifests are validated with jsonschema", str(error), "the extra kubernetes",
                "pip install 'yesnt[kubernetes]'",
            ) from error  # fmt: skip

    def _manifests(self, name: str) -> list[Manifest]:
        self._certificate = make_certificate()
        return manifests(name, self._profile, self._spec.workers, self._spec.gpu, self._certificate)

    @contextmanager
    def open(self) -> Iterator[Running]:
        """Creates the objects, waits for the scheduler, and deletes all at the end.

        Raises:
            UsageError: the cluster refuses the objects.
            ClusterLostError: the scheduler does not become ready.
        """
        name = f"yesnt-{uuid4().hex[:8]}"
        objects = self._manifests(name)
        with ExitStack() as stack:
            stack.callback(self._delete, name)  # also if only a part of them is created
            self._create(objects)
            self._wait_until_ready(name)
            if "KUBERNETES_SERVICE_HOST" in os.environ:  # the driver is a pod itself
                address, dashboard = scheduler_address(name), ""
            else:
                address, dashboard = stack.enter_context(self._forwarded(name))
            yield Running(address, self._certificate.security(), dashboard=dashboard)

    def _create(self, objects: list[Manifest]) -> None:
        done = self._kubectl(
            "apply", "--filename=-", text=json.dumps({"apiVersion": "v1", "kind": "List", "items": objects})
        )
        if done.returncode:
            raise UsageError(
                f"The Kubernetes cluster refuses the run's objects ({done.stderr.strip()})", "kubectl apply",
                "a cluster with Dask's operator, and the right to create secrets and daskclusters",
                "install the operator (deploy/README.md), or ask for the right",
            )  # fmt: skip

    def _wait_until_ready(self, name: str) -> None:
        deadline, last = time.monotonic() + READY_SECONDS, "no pod yet"
        selector = f"dask.org/cluster-name={name},dask.org/component=scheduler"
        while time.monotonic() < deadline:
            done = self._kubectl("wait", "--for=condition=Ready", "pod", f"--selector={selector}", "--timeout=20s")
            if done.returncode == 0:
                return
            last = done.stderr.strip() or last
            time.sleep(POLL_SECONDS)
        raise ClusterLostError(
            f"The scheduler's pod is not ready after {READY_SECONDS} s ({last})", f"pods of {name}",
            "a node that may run it and an image that can be pulled",
            "look at `kubectl describe pod`, and at `image` and `scheduler_nodes` of the profile",
        )  # fmt: skip

    @contextmanager
    def _forwarded(self, name: str) -> Iterator[tuple[str, str]]:
        """Yields the addresses of scheduler and dashboard on this machine, as long as kubectl forwards them."""
        log = worker_logs(self._spec.folder) / "port-forward.log"
        # A pod, not the service: the dashboard listens on the pod's loopback alone.
        pod = f"deployment/{name}-scheduler"
        with log.open("w") as stream:
            process = self._start(
                "port-forward", "--address=127.0.0.1", pod, f":{PORT}", f":{DASHBOARD_PORT}", log=stream
            )
            try:
                ports = self._ports(process, log)
                yield f"tls://127.0.0.1:{ports[PORT]}", f"http://127.0.0.1:{ports[DASHBOARD_PORT]}/status"
            finally:
                process.terminate()
                process.wait()

    def _ports(self, process: subprocess.Popen[str], log: Path) -> dict[int, int]:
        """Ports of this machine by those of the pod, as kubectl prints them."""
        deadline = time.monotonic() + FORWARD_SECONDS
        while time.monotonic() < deadline and process.poll() is None:
            found = re.findall(r"Forwarding from 127\.0\.0\.1:(\d+) -> (\d+)", log.read_text())
            ports = {int(there): int(here) for here, there in found}
            if {PORT, DASHBOARD_PORT} <= set(ports):
                return ports
            time.sleep(0.1)
        raise ClusterLostError(
            f"kubectl does not forward the scheduler's port ({log.read_text().strip() or 'no answer'})",
            "kubectl port-forward", "the right to forward ports", "ask for it, or run the driver in a pod",
        )  # fmt: skip

    def _delete(self, name: str) -> None:
        self._kubectl("delete", "daskclusters,daskworkergroups,secrets", f"--selector=yesnt/run={name}", "--wait=false",
                      "--ignore-not-found")  # fmt: skip

    def _words(self, *words: str) -> list[str]:
        options = (("--namespace", self._profile.namespace), ("--context", self._profile.context))
        return ["kubectl", *words, *(f"{name}={value}" for name, value in options if value)]

    def _kubectl(self, *words: str, text: str | None = None) -> subprocess.CompletedProcess[str]:
        try:
            return subprocess.run(
                self._words(*words), input=text, capture_output=True, text=True, timeout=COMMAND_SECONDS,
                start_new_session=True,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return subprocess.CompletedProcess(words, 1, "", f"kubectl does not answer within {COMMAND_SECONDS} s")

    def _start(self, *words: str, log: IO[str]) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self._words(*words), stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        )  # fmt: skip
