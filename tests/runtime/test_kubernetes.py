"""Kubernetes: manifests that the operator's schema accepts, and a cluster whose containers run as processes here."""

from __future__ import annotations

import copy
import importlib.util
import json
import os
import sys
from pathlib import Path

import pytest

from yesnt.core.errors import MissingPartError, UsageError
from yesnt.runtime.cluster.open_cluster import dashboard_of, open_cluster
from yesnt.runtime.launchers import kubernetes
from yesnt.runtime.launchers.certificates import make_certificate
from yesnt.runtime.launchers.manifests import NOT_PREEMPTIBLE, Manifest, manifests
from yesnt.runtime.launchers.operator_schema import check_manifest
from yesnt.runtime.launchers.profile import Kubernetes
from yesnt.runtime.launchers.read_profile import parse_profile
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.table import check_cluster

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")

PROFILE = {
    "kind": "kubernetes", "image": "registry/yesnt:1", "memory": "2GiB", "workers": "1",
    "volumes": [{"path": "/shows", "claim": "shows"}, {"path": "/cache", "nfs": "server:/export/cache"}],
    "scheduler_nodes": {"pool": "steady"}, "setup": ["ulimit -c 0"],
    "gpu": {"workers": "2", "tolerations": [{"key": "nvidia.com/gpu", "operator": "Exists"}]},
}  # fmt: skip


def parsed(**keys: object) -> Kubernetes:
    profile = parse_profile({**PROFILE, **keys}, "x")
    assert isinstance(profile, Kubernetes)
    return profile


def made(gpu: bool = True) -> dict[str, Manifest]:
    return {m["kind"]: m for m in manifests("yesnt-1", parsed(), 3, gpu, make_certificate())}


def test_the_operator_accepts_the_manifests() -> None:
    found = made()
    assert set(found) == {"Secret", "DaskCluster", "DaskWorkerGroup"}
    for manifest in found.values():
        check_manifest(manifest)
    assert set(made(gpu=False)) == {"Secret", "DaskCluster"}


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("spec", "worker", "spec", "nodeSelectr"), {}, r"'nodeSelectr' was unexpected.*spec\.worker\.spec"),
        (("spec", "worker", "replicas"), "3", r"'3' is not of type 'integer'.*spec\.worker\.replicas"),
    ],
)
def test_a_manifest_that_the_operator_would_cut_or_refuse_is_refused(
    place: tuple[str, ...], value: object, message: str
) -> None:
    manifest = copy.deepcopy(made()["DaskCluster"])
    part = manifest
    for name in place[:-1]:
        part = part[name]
    part[place[-1]] = value
    with pytest.raises(UsageError, match=message):
        check_manifest(manifest)


def test_the_scheduler_is_where_it_stays_and_its_dashboard_is_its_own() -> None:
    pod = made()["DaskCluster"]["spec"]["scheduler"]["spec"]
    terms = pod["affinity"]["nodeAffinity"]["requiredDuringSchedulingIgnoredDuringExecution"]["nodeSelectorTerms"]
    assert {rule["key"] for rule in terms[0]["matchExpressions"]} == set(NOT_PREEMPTIBLE)
    assert pod["nodeSelector"] == {"pool": "steady"}
    command = pod["containers"][0]["command"]
    assert command[command.index("--dashboard-address") + 1].startswith("127.0.0.1:")
    assert command[command.index("--protocol") + 1] == "tls://"


def test_pods_have_the_shared_folders_the_user_and_their_resource() -> None:
    found = made()
    for manifest, resource in (("DaskCluster", "CPU=1"), ("DaskWorkerGroup", "GPU=1")):
        pod = found[manifest]["spec"]["worker"]["spec"]
        container = pod["containers"][0]
        assert [m["mountPath"] for m in container["volumeMounts"]] == ["/shows", "/cache", "/run/yesnt-tls"]
        assert pod["volumes"][1]["nfs"] == {"server": "server", "path": "/export/cache"}
        assert pod["securityContext"]["runAsUser"] == os.getuid()
        assert container["image"] == "registry/yesnt:1"
        assert resource in container["command"]
    assert found["DaskWorkerGroup"]["spec"]["worker"]["spec"]["containers"][0]["resources"]["limits"]["nvidia.com/gpu"]


def test_a_volume_has_one_source() -> None:
    with pytest.raises(UsageError, match="exactly one of `claim`, `nfs` and `host_path`"):
        parsed(volumes=[{"path": "/a"}])


def test_what_is_absent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = ClusterSpec("kubernetes", profile=parsed())
    monkeypatch.setenv("PATH", "")
    with pytest.raises(UsageError, match=r"command kubectl is not on this machine.*install kubectl"):
        check_cluster(spec)
    monkeypatch.setattr(kubernetes, "require_command", lambda *words: None)
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "dask_kubernetes" else find(name))
    from yesnt.runtime.launchers import operator_schema

    operator_schema._schemas.cache_clear()
    with pytest.raises(MissingPartError, match=r"yesnt\[kubernetes\]"):
        check_cluster(spec)


@pytest.fixture
def fake_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of a stand-in cluster, whose kubectl is the first on the search path."""
    programs = tmp_path / "bin"
    programs.mkdir()
    fake = Path(__file__).parent / "fake_kubectl.py"
    (programs / "kubectl").write_text(f'#!/bin/sh\nexec {sys.executable} {fake} "$@"\n')
    (programs / "kubectl").chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("FAKE_CLUSTER", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    monkeypatch.delenv("KUBERNETES_SERVICE_HOST", raising=False)
    return tmp_path


def test_the_containers_make_a_cluster_that_a_run_can_use(fake_cluster: Path) -> None:
    spec = ClusterSpec("kubernetes", 1, profile=parsed()).of_job(False, fake_cluster / "run")
    with open_cluster(spec) as client:
        client.wait_for_workers(1, timeout=60)
        (worker,) = client.scheduler_info(n_workers=-1)["workers"].values()
        assert worker["resources"] == {"CPU": 1.0}
        assert client.scheduler.address.startswith("tls://127.0.0.1:")
        port = json.loads((fake_cluster / "ports.json").read_text())["8787"]
        assert dashboard_of(client) == f"http://127.0.0.1:{port}/status"
        assert client.submit(len, "abc", pure=False).result(timeout=60) == 3
    assert "--selector=yesnt/run=yesnt-" in (fake_cluster / "deleted").read_text()


def test_a_cluster_that_refuses_the_objects_is_named(fake_cluster: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (fake_cluster / "bin" / "kubectl").write_text("#!/bin/sh\necho 'secrets is forbidden' >&2; exit 1\n")
    with (
        pytest.raises(UsageError, match=r"refuses the run's objects \(secrets is forbidden\).*install the operator"),
        open_cluster(ClusterSpec("kubernetes", 1, profile=parsed()).of_job(False, None)),
    ):
        pass
