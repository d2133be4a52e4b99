"""What lies in deploy/ and docker/ is what the code means, and the start scripts bring up a cluster that is usable."""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.docker.dockerfile import entry_point, steps_of
from yesnt.runtime.cluster.open_cluster import open_cluster
from yesnt.runtime.cluster.worker_settings import ALLOCATOR, dask_settings
from yesnt.runtime.launchers.spec import ClusterSpec, read_cluster

ROOT = Path(__file__).parent.parent
DOCKERFILES = sorted((ROOT / "docker").glob("*.Dockerfile"))

PROFILES = sorted(path for path in (ROOT / "deploy").rglob("*.yaml") if path.name != "dask.yaml")


def flat(tree: dict[str, Any], path: str = "") -> dict[str, Any]:
    """`{"a": {"b": 1}}` -> `{"a.b": 1}`, down to the settings that the code names."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{path}{key}"
        found |= flat(value, f"{name}.") if isinstance(value, dict) and name not in dask_settings() else {name: value}
    return found


def test_farm_workers_get_the_same_settings_as_local_ones() -> None:
    assert flat(yaml.safe_load((ROOT / "deploy" / "dask.yaml").read_text())) == dask_settings()


@pytest.mark.parametrize("path", DOCKERFILES, ids=lambda path: path.stem)
def test_images_hold_the_tested_versions_and_start_what_is_installed(path: Path) -> None:
    steps = steps_of(path)
    copied = {name for step in steps if step.word == "COPY" for name in step.argument.split()[:-1]}
    assert {"pyproject.toml", "constraints.txt", "README.md", "LICENSE", "yesnt", "workflows"} == copied
    assert all((ROOT / name).exists() for name in copied)
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert kept == copied
    (install,) = (step.argument for step in steps if step.word == "RUN" and "pip install" in step.argument)
    assert "-c constraints.txt" in install
    (extras,) = re.findall(r"\.\[([a-z,]+)\]", install)
    project = (ROOT / "pyproject.toml").read_text()
    assert all(re.search(rf"^{extra} = \[", project, re.M) for extra in extras.split(","))
    assert re.search(rf"^{entry_point(steps)[0]} = ", project, re.M)
    assert [step.argument for step in steps if step.word == "USER"] == ["artist"], "nothing runs as root"


def test_manifests_name_the_images_that_are_built_here() -> None:
    named = set(re.findall(r"image: (\S+)", (ROOT / "deploy" / "kubernetes" / "kubernetes.yaml").read_text()))
    built = {tag for path in DOCKERFILES for tag in re.findall(r"-t (yesnt:\S+)", path.read_text())}
    assert named == built
    version = re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)
    assert version is not None
    assert built == {f"yesnt:{version.group(1)}", f"yesnt:{version.group(1)}-gpu"}


@pytest.mark.parametrize("path", PROFILES, ids=lambda path: path.stem)
@pytest.mark.parametrize("whole", [False, True], ids=["as it is", "with every key that it shows"])
def test_example_profiles_are_accepted(path: Path, whole: bool, tmp_path: Path) -> None:
    text = path.read_text()
    if whole:
        text = re.sub(r"^# (?=(  )?[a-z_]+:)", "", text, flags=re.M)
    (tmp_path / path.name).write_text(text)
    spec = read_cluster(str(tmp_path / path.name))
    assert spec.profile is not None
    if whole and path.stem in ("ssh", "slurm", "kubernetes"):
        assert spec.profile.gpu is not None


def test_the_page_names_every_profile() -> None:
    page = (ROOT / "deploy" / "README.md").read_text()
    assert {str(path.relative_to(ROOT / "deploy")) for path in PROFILES} == set(re.findall(r"\]\((\S+\.yaml)\)", page))


@pytest.mark.parametrize("script", sorted((ROOT / "deploy").glob("*/start.sh")), ids=lambda path: path.parent.name)
def test_scripts_are_sound_shell(script: Path) -> None:
    assert os.access(script, os.X_OK)
    subprocess.run(["bash", "-n", script], check=True)


def free_run(count: int) -> int:
    """The first of `count` free ports in a row, below those that the kernel hands out to whoever connects meanwhile."""
    for port in random.SystemRandom().sample(range(20000, 30000), 200):
        with ExitStack() as probes:
            try:
                for number in range(port, port + count):
                    probes.enter_context(socket.socket()).bind(("127.0.0.1", number))
            except OSError:
                continue
            return port
    raise AssertionError("no free ports")


@contextmanager
def started(tmp_path: Path, name: str, *arguments: str) -> Iterator[int]:
    """A deploy script under way; yields the scheduler's port."""
    port = free_run(3)
    environment = os.environ | {
        "PORT": str(port), "PYTHON": sys.executable, "PYTHONPATH": str(ROOT),
    }  # fmt: skip
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(
            [ROOT / "deploy" / name / "start.sh", *arguments],
            env=environment, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
    try:
        yield port
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.skipif(shutil.which("bash") is None, reason="the scripts are bash")
def test_a_started_cluster_is_one_that_a_run_can_use(tmp_path: Path) -> None:
    with started(tmp_path, "local", "2") as port, open_cluster(ClusterSpec(f"tcp://127.0.0.1:{port}")) as client:
        client.wait_for_workers(2, timeout=90)
        assert set(client.nthreads().values()) == {1}
        seen = client.run(lambda: {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", *ALLOCATOR)})
        assert list(seen.values()) == [{"OMP_NUM_THREADS": "1", **ALLOCATOR}] * 2
        assert client.run_on_scheduler(_allowed_failures) == 0
        assert client.submit(len, "abc", pure=False).result(timeout=60) == 3


def _allowed_failures() -> int:
    import dask

    return int(dask.config.get("distributed.scheduler.allowed-failures"))
