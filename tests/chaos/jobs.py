"""A small job, run as a user runs it, and what it delivered."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.tiny_shot import write_tiny_shot

FRAMES = 5
ROOT = Path(__file__).parents[2]


def new_job(folder: Path, frames: int = FRAMES) -> Path:
    """A job without results; what an earlier attempt left is removed."""
    return write_tiny_shot(folder / "shot", frames)


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of every delivered EXR of a job file."""
    files = sorted((path.parent / "out" / "exr").glob("*.exr"))
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def start(path: Path, *options: str, fault: str = "", module: str = "yesnt") -> subprocess.Popen[str]:
    """Starts a run in a process group of its own; without core files, which a segfault would leave."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **({"YESNT_FAULT": fault} if fault else {})}
    command = ["sh", "-c", 'ulimit -c 0; exec "$@"', "sh", sys.executable, "-m", module, "run", str(path), *options]
    return subprocess.Popen(
        command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )


def finish(process: subprocess.Popen[str], seconds: float = 180) -> tuple[int, str]:
    """Exit status and output of a run; one that hangs is killed and fails."""
    try:
        out, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, _ = process.communicate()
        raise AssertionError(f"hung for {seconds} s:\n{out[-3000:]}") from None
    return process.returncode, out
