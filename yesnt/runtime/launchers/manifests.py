"""Manifests of a run on Kubernetes: a secret with its certificate, a DaskCluster, a DaskWorkerGroup for GPUs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from yesnt.runtime.cluster.worker_settings import WORKER_ENVIRONMENT
from yesnt.runtime.launchers.certificates import Certificate
from yesnt.runtime.launchers.profile import Kubernetes, Volume
from yesnt.runtime.launchers.table import CPU, GPU
from yesnt.runtime.launchers.worker_command import WORKER_MODULE, WorkerGroup, certificate_options, worker_options

Manifest = dict[str, Any]

SCHEDULER_MODULE = "yesnt.runtime.cluster.scheduler"
PORT, DASHBOARD_PORT = 8786, 8787
TLS_FOLDER = "/run/yesnt-tls"
TLS_MODE = 0o440
"""Of the certificate's files in a pod: readable by the group that the pod runs as."""

OVERHEAD_BYTES = 512 << 20
"""Memory of a pod beside its worker's limit: Dask's nanny, which ends a worker before Kubernetes ends the pod."""

SCHEDULER_BYTES = 2 << 30

NOT_PREEMPTIBLE = {
    "cloud.google.com/gke-spot": "true",
    "cloud.google.com/gke-preemptible": "true",
    "eks.amazonaws.com/capacityType": "SPOT",
    "karpenter.sh/capacity-type": "spot",
    "kubernetes.azure.com/scalesetpriority": "spot",
}
"""Labels of nodes that may be taken away at any time; the scheduler is not placed there, since a run ends with it."""


def manifests(name: str, profile: Kubernetes, workers: int, gpu: bool, certificate: Certificate) -> list[Manifest]:
    """All objects of a run.

    Args:
        name: of the cluster, unique in its namespace.
        profile: of the site.
        workers: CPU workers.
        gpu: whether the job needs GPU workers too.
        certificate: of the run.
    """
    found = [_secret(name, certificate), _cluster(name, profile, workers)]
    if gpu and profile.gpu is not None:
        found.append(_gpu_group(name, profile))
    return found


def scheduler_address(name: str) -> str:
    """Address of the scheduler for pods of the same namespace."""
    return f"tls://{name}-scheduler:{PORT}"


def _secret(name: str, certificate: Certificate) -> Manifest:
    return {
        "apiVersion": "v1", "kind": "Secret", "metadata": _metadata(f"{name}-tls", name), "type": "Opaque",
        "stringData": {"certificate.pem": certificate.certificate, "key.pem": certificate.key},
    }  # fmt: skip


def _cluster(name: str, profile: Kubernetes, workers: int) -> Manifest:
    selector = {"dask.org/cluster-name": name, "dask.org/component": "scheduler"}
    ports = [{"name": "tcp-comm", "protocol": "TCP", "port": PORT, "targetPort": "tcp-comm"}]
    memory = int(profile.memory)
    worker = _pod(name, profile, _worker_container(name, profile, CPU, memory, profile.image, {"cpu": "1"}))
    worker |= {"nodeSelector": dict(profile.node_selector), "tolerations": [dict(t) for t in profile.tolerations]}
    return {
        "apiVersion": "kubernetes.dask.org/v1", "kind": "DaskCluster", "metadata": _metadata(name, name),
        "spec": {
            "scheduler": {
                "metadata": {"annotations": {"cluster-autoscaler.kubernetes.io/safe-to-evict": "false"}},
                "spec": _scheduler_pod(name, profile),
                "service": {"type": "ClusterIP", "selector": selector, "ports": ports},
            },
            "worker": {"replicas": workers, "spec": worker},
        },
    }  # fmt: skip


def _gpu_group(name: str, profile: Kubernetes) -> Manifest:
    gpu = profile.gpu
    assert gpu is not None
    container = _worker_container(name, profile, GPU, int(gpu.memory), gpu.image or profile.image, {gpu.resource: "1"})
    pod = _pod(name, profile, container)
    pod |= {"nodeSelector": dict(gpu.node_selector), "tolerations": [dict(t) for t in gpu.tolerations]}
    return {
        "apiVersion": "kubernetes.dask.org/v1", "kind": "DaskWorkerGroup", "metadata": _metadata(f"{name}-gpu", name),
        "spec": {"cluster": name, "worker": {"replicas": gpu.workers, "spec": pod}},
    }  # fmt: skip


def _metadata(name: str, run: str) -> Manifest:
    return {"name": name, "labels": {"app.kubernetes.io/managed-by": "yesnt", "yesnt/run": run}}


def _scheduler_pod(name: str, profile: Kubernetes) -> Manifest:
    options = ["--host", "0.0.0.0", "--port", str(PORT), "--protocol", "tls://", *_certificate_options()]
    # TLS does not protect the dashboard: it is bound to the pod's loopback, which `kubectl port-forward` reaches.
    options += ["--dashboard-address", f"127.0.0.1:{DASHBOARD_PORT}"]
    container = _container("scheduler", profile, profile.image, [SCHEDULER_MODULE, *options])
    container["ports"] = [{"name": "tcp-comm", "containerPort": PORT, "protocol": "TCP"}]
    container["readinessProbe"] = {"tcpSocket": {"port": "tcp-comm"}, "periodSeconds": 2}
    container["resources"] = _resources({"cpu": "1", "memory": str(SCHEDULER_BYTES)})
    pod = _pod(name, profile, container)
    rules = [{"key": key, "operator": "NotIn", "values": [value]} for key, value in NOT_PREEMPTIBLE.items()]
    required = {"nodeSelectorTerms": [{"matchExpressions": rules}]}
    pod["affinity"] = {"nodeAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": required}}
    pod["nodeSelector"] = dict(profile.scheduler_nodes)
    return pod


def _worker_container(
    name: str, profile: Kubernetes, pool: str, memory: int, image: str, resources: Mapping[str, str]
) -> Manifest:
    # The operator sets DASK_WORKER_NAME, and Kubernetes puts its value into the arguments.
    group = WorkerGroup("$(DASK_WORKER_NAME)", pool, 1, memory)
    options = [*worker_options(profile, group), *_certificate_options()]
    container = _container("worker", profile, image, [WORKER_MODULE, scheduler_address(name), *options])
    container["resources"] = _resources({**resources, "memory": str(memory + OVERHEAD_BYTES)})
    return container


def _container(name: str, profile: Kubernetes, image: str, words: list[str]) -> Manifest:
    command = [profile.python or "python", "-m", *words]
    if profile.setup:
        lines = "\n".join(["set -e", *profile.setup, 'exec "$@"'])
        command = ["bash", "-c", lines, "yesnt", *command]
    # A user number that the image does not know has no home of its own.
    variables = {"HOME": "/tmp", **WORKER_ENVIRONMENT, **profile.environment}
    mounts = [{"name": _volume_name(i), "mountPath": volume.path} for i, volume in enumerate(profile.volumes)]
    return {
        "name": name, "image": image, "command": command,
        "env": [{"name": key, "value": value} for key, value in variables.items()],
        "volumeMounts": [*mounts, {"name": "tls", "mountPath": TLS_FOLDER, "readOnly": True}],
        "securityContext": {"allowPrivilegeEscalation": False},
    }  # fmt: skip


def _pod(name: str, profile: Kubernetes, container: Manifest) -> Manifest:
    """A pod that runs as the user who started the run, as the shared folders know them."""
    user = os.getuid() if profile.user is None else profile.user
    group = os.getgid() if profile.group is None else profile.group
    volumes = [{"name": _volume_name(i), **_source(volume)} for i, volume in enumerate(profile.volumes)]
    return {
        "containers": [container],
        "volumes": [*volumes, {"name": "tls", "secret": {"secretName": f"{name}-tls", "defaultMode": TLS_MODE}}],
        "securityContext": {"runAsUser": user, "runAsGroup": group, "fsGroup": group,
                            "fsGroupChangePolicy": "OnRootMismatch"},
        "imagePullSecrets": [{"name": secret} for secret in profile.image_pull_secrets],
        "automountServiceAccountToken": False,
    }  # fmt: skip


def _source(volume: Volume) -> Manifest:
    if volume.claim is not None:
        return {"persistentVolumeClaim": {"claimName": volume.claim}}
    if volume.nfs is not None:
        server, _, path = volume.nfs.partition(":")
        return {"nfs": {"server": server, "path": path}}
    return {"hostPath": {"path": volume.host_path, "type": "Directory"}}


def _volume_name(index: int) -> str:
    return f"shared-{index}"


def _resources(amounts: Mapping[str, str]) -> Manifest:
    """Requests and limits; processors are not limited, since a limit throttles."""
    return {"requests": dict(amounts), "limits": {key: value for key, value in amounts.items() if key != "cpu"}}


def _certificate_options() -> list[str]:
    return certificate_options(f"{TLS_FOLDER}/certificate.pem", f"{TLS_FOLDER}/key.pem")
