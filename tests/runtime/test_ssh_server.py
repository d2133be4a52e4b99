"""A run over a real OpenSSH server on this machine; needs `sshd`."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
import yaml

from tests.tiny_shot import write_tiny_shot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SSHD = shutil.which("sshd") or "/usr/sbin/sshd"
FRAMES, SIZE = 16, (96, 80)


@pytest.fixture
def client_config(tmp_path: Path) -> Iterator[Path]:
    """Configuration of a client for which node01 and node02 are a server of ours."""
    if not Path(SSHD).exists():
        pytest.skip("needs OpenSSH's server (apt-get install openssh-server)")
    folder = tmp_path / "ssh"
    folder.mkdir(mode=0o700)
    for name in ("id", "host"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = {
        "Port": port, "ListenAddress": "127.0.0.1", "HostKey": folder / "host", "AuthorizedKeysFile": folder / "id.pub",
        "PidFile": "none", "UsePAM": "no", "StrictModes": "no", "PermitRootLogin": "yes",
    }  # fmt: skip
    (folder / "sshd_config").write_text("".join(f"{key} {value}\n" for key, value in options.items()))
    (folder / "config").write_text(
        f"Host node01 node02\n  HostName 127.0.0.1\n  Port {port}\n  IdentityFile {folder / 'id'}\n"
        f"  StrictHostKeyChecking no\n  UserKnownHostsFile {folder / 'known'}\n"
    )
    Path("/run/sshd").mkdir(exist_ok=True)
    server = subprocess.Popen([SSHD, "-D", "-f", folder / "sshd_config"])
    yield folder / "config"
    server.terminate()
    server.wait()


def yesnt(*words: object) -> list[str]:
    return [sys.executable, "-m", "yesnt", *map(str, words)]


def test_a_lost_connection_and_a_killed_worker_change_no_byte(tmp_path: Path, client_config: Path) -> None:
    local, remote = (write_tiny_shot(tmp_path / name, FRAMES, SIZE) for name in ("local", "a shot"))
    subprocess.run(yesnt("run", local), check=True, stdout=subprocess.DEVNULL)
    farm = {
        "kind": "ssh", "hosts": {"node01": 1, "node02": 1}, "memory": "1500MiB", "interface": "lo",
        "command": ["ssh", "-F", str(client_config), "-o", "BatchMode=yes"],
        "environment": {"PYTHONPATH": str(Path(__file__).parents[2])},
    }  # fmt: skip
    (tmp_path / "farm.yaml").write_text(yaml.safe_dump(farm))
    lines, cut, killed = [], False, False
    words = yesnt("run", remote, "--cluster", tmp_path / "farm.yaml")
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            lines.append(line)
            percent = int(found[1]) if (found := re.match(r"progress (\d+)%", line)) else 0
            if percent >= 20 and not cut:
                connections = [p for p in psutil.Process(run.pid).children() if p.name() == "ssh"]
                connections[0].kill()
                cut = True
            if percent >= 50 and not killed:
                workers = [p for p in psutil.process_iter() if _is_worker(p, "cpu-1.1")]
                workers[0].kill()
                killed = True
    assert run.wait() == 0, "".join(lines[-20:])
    assert cut
    assert killed
    for path in sorted((local.parent / "out/exr").glob("*.exr")):
        assert (remote.parent / "out/exr" / path.name).read_bytes() == path.read_bytes()
    log = (remote.parent / "out/run/workers/launcher.log").read_text()
    assert "cpu-0.1 has ended" in log
    assert "cpu-0.2 is started" in log


def _is_worker(process: psutil.Process, name: str) -> bool:
    """Whether a process is the worker proper of a group: the child of its nanny."""
    try:
        parent = process.parent()
        return parent is not None and name in parent.cmdline() and "spawn_main" in " ".join(process.cmdline())
    except psutil.NoSuchProcess:
        return False
