"""The steps of the images in a clean Debian root, up to the demo: minutes, root and a network; `make test-images`.

No container engine is needed: a root made by debootstrap stands in for the base image, chroot for the engine.
$DEBIAN_ROOT may name a bookworm root with python3-venv to copy instead.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.docker.dockerfile import entry_point, steps_of

pytestmark = [pytest.mark.images, pytest.mark.timeout(3600)]

ROOT = Path(__file__).parents[2]
BASE = "python:3.11-slim-bookworm"
"""Debian 12's own Python is 3.11 too."""

SETTINGS = ("/etc/pip.conf", "/etc/resolv.conf", "/etc/hosts", "/etc/ssl/certs", "/root/.config/pip")
"""What lets pip inside reach what it reaches outside."""


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if os.geteuid() != 0:
        pytest.skip("chroot needs root")
    if given := os.environ.get("DEBIAN_ROOT"):
        return Path(given)
    if shutil.which("debootstrap") is None:
        pytest.skip("a clean root needs debootstrap (apt-get install debootstrap), or $DEBIAN_ROOT")
    root = tmp_path_factory.mktemp("debian") / "root"
    packages = "ca-certificates,python3,python3-venv"
    subprocess.run(["debootstrap", "--variant=minbase", f"--include={packages}", "bookworm", root], check=True)
    return root


@contextmanager
def container(pristine: Path, root: Path) -> Iterator[None]:
    """A copy of the root with the kernel's file systems and this machine's package settings."""
    subprocess.run(["cp", "-a", pristine, root], check=True)
    for name in filter(os.path.exists, SETTINGS):
        inside = root / name.lstrip("/")
        inside.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run(["rm", "-rf", inside], check=True)
        subprocess.run(["cp", "-rL", name, inside], check=True)
    wheels = [path for path in os.environ.get("PIP_FIND_LINKS", "").split() if Path(path).is_dir()]
    with ExitStack() as stack:
        for name in ("/proc", "/dev", *wheels):
            inside = root / name.lstrip("/")
            inside.mkdir(parents=True, exist_ok=True)
            subprocess.run(["mount", "--rbind", name, inside], check=True)
            stack.callback(subprocess.run, ["umount", "-lR", inside], check=True)
            subprocess.run(["mount", "--make-rslave", inside], check=True)
        yield


class Image:
    """Runs a Dockerfile's instructions in a root."""

    def __init__(self, root: Path) -> None:
        self._root, self._user, self._folder = root, "root", "/"
        self.environment = {"PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin", "LANG": "C.UTF-8"}

    def run(self, command: str, **variables: str) -> str:
        """Runs a shell command as the image's user; returns what it prints."""
        pip = {key: value for key, value in os.environ.items() if key.startswith("PIP_") or "proxy" in key.lower()}
        words = [f"{key}={value}" for key, value in {**pip, **self.environment, **variables}.items()]
        script = f"cd {shlex.quote(self._folder)} && {command}"
        done = subprocess.run(
            ["chroot", f"--userspec={self._user}", self._root, "/usr/bin/env", "-i", *words, "/bin/sh", "-c", script],
            text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}"
        return done.stdout

    def step(self, word: str, argument: str) -> None:
        """Carries out one instruction."""
        if word == "FROM":
            assert argument == BASE
        elif word == "WORKDIR":
            self._folder = argument
            (self._root / argument.lstrip("/")).mkdir(parents=True, exist_ok=True)
        elif word == "COPY":
            *sources, target = argument.split()
            for source in sources:
                inside = self._root / self._folder.lstrip("/") / target
                command = ["cp", "-a", ROOT / source, inside / source if target.endswith("/") else inside]
                subprocess.run(command, check=True)
        elif word == "ENV":
            key, _, value = argument.partition("=")
            self.environment[key] = value
        elif word == "USER":
            self._user = argument
        elif word == "RUN":
            self.run(argument)


@pytest.mark.parametrize("name", ["cpu", "gpu"])
def test_the_steps_of_an_image_lead_to_a_demo(name: str, pristine: Path, tmp_path: Path) -> None:
    steps = steps_of(ROOT / "docker" / f"{name}.Dockerfile")
    root = tmp_path / "root"
    with container(pristine, root):
        image = Image(root)
        for step in steps:
            image.step(step.word, step.argument)
        entry = shlex.join(entry_point(steps))
        assert "ok" in image.run(f"{entry} doctor", HOME="/tmp")
        (root / "tmp").chmod(0o1777)
        printed = image.run(f"{entry} demo /tmp/demo", HOME="/tmp")
        assert "progress 100%" in printed
        assert len(list((root / "tmp/demo/out/exr").glob("*.exr"))) == 16
        for module in ("scheduler", "worker"):
            image.run(f"python -m yesnt.runtime.{module} --version", HOME="/tmp")
