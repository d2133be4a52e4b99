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

from yesnt.runtime.cluster import open_cluster
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.worker_settings import ALLOCATOR, dask_settings

ROOT = Path(__file__).parent.parent
DOCKERFILES = sorted((ROOT / "docker").glob("*.Dockerfile"))

FAKE_SSH = """#!/usr/bin/env bash
# stands in for ssh on one machine: drops options and host, runs the rest; forwarding to oneself is nothing to do
while [[ $1 == -* ]]; do case $1 in -tt) shift;; *) shift 2;; esac; done
shift; exec bash -c "$*"
"""


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
def test_images_copy_what_exists_and_start_what_is_installed(path: Path) -> None:
    text = path.read_text()
    copied = [name for line in re.findall(r"^COPY (.*)$", text, re.M) for name in line.split()[:-1]]
    assert {"pyproject.toml", "README.md", "LICENSE", "yesnt", "workflows"} <= set(copied)
    assert all((ROOT / name).exists() for name in copied)
    entry = re.search(r'^ENTRYPOINT \["([^"]+)"\]', text, re.M)
    assert entry is not None
    assert re.search(rf"^{Path(entry.group(1)).name} = ", (ROOT / "pyproject.toml").read_text(), re.M)
    assert re.search(r"^USER (?!root)", text, re.M), "nothing runs as root"


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
    (tmp_path / "ssh").write_text(FAKE_SSH)
    (tmp_path / "ssh").chmod(0o755)
    environment = os.environ | {
        "PORT": str(port), "PYTHON": sys.executable, "REMOTE_PYTHON": sys.executable, "REMOTE_ROOT": str(ROOT),
        "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT),
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
@pytest.mark.parametrize(("name", "arguments"), [("local", ("2",)), ("ssh", ("here", "there"))])
def test_a_started_cluster_is_one_that_a_run_can_use(tmp_path: Path, name: str, arguments: tuple[str, ...]) -> None:
    with started(tmp_path, name, *arguments) as port, open_cluster(ClusterSpec(f"tcp://127.0.0.1:{port}")) as client:
        client.wait_for_workers(2, timeout=90)
        assert set(client.nthreads().values()) == {1}
        seen = client.run(lambda: {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", *ALLOCATOR)})
        assert list(seen.values()) == [{"OMP_NUM_THREADS": "1", **ALLOCATOR}] * 2
        assert client.run_on_scheduler(_allowed_failures) == 0
        assert client.submit(len, "abc", pure=False).result(timeout=60) == 3


def _allowed_failures() -> int:
    import dask

    return int(dask.config.get("distributed.scheduler.allowed-failures"))
