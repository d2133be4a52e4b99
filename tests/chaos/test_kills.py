"""Killing anything at any moment costs at most the work in flight: the delivered bytes are those of an unkilled run."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.chaos.jobs import FRAMES, digests, finish, start
from tests.tiny_shot import write_tiny_shot

POINTS = {
    "worker": ("record.before_commit", "record.after_commit", "exr.before_rename", "shard.before_rename"),
    "driver": ("driver.after_submit", "driver.after_receipt"),
}
EX_TEMPFAIL = 75


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    path = write_tiny_shot(tmp_path_factory.mktemp("reference") / "shot", FRAMES)
    code, out = finish(start(path))
    assert code == 0, out
    return digests(path)


def strike(path: Path, choice: random.Random, number: int) -> bool:
    """Starts the job with one kill somewhere; whether it struck."""
    role = choice.choice(("worker", "worker", "driver", "power cut"))
    if role == "power cut":
        process = start(path)
        time.sleep(choice.uniform(1.0, 7.0))
        struck = process.poll() is None
        if struck:
            os.killpg(process.pid, signal.SIGKILL)  # driver, scheduler and workers at once
        finish(process)
        return struck
    token = path.parent / f"token{number}"
    token.touch()
    how = "kill" if role == "driver" else choice.choice(("kill", "segfault", "exit"))
    code, out = finish(start(path, fault=f"{choice.choice(POINTS[role])}:{choice.randint(1, 4)}:{token}:{how}"))
    assert code in (0, -signal.SIGKILL), out
    return not token.exists()


def run_under_kills(path: Path, kills: int, seed: int, reference: dict[str, str]) -> None:
    """Kills the job again and again; it resumes each time, and starts anew each time it got to its end."""
    choice, struck = random.Random(seed), 0
    for number in range(3 * kills):
        struck += strike(path, choice, number)
        if struck == kills:
            break
        if len(digests(path)) == FRAMES and (path.parent / "out" / "run" / "preview.mp4").exists():
            assert digests(path) == reference
            shutil.rmtree(path.parent / "out")
    assert struck == kills
    code, out = finish(start(path))
    assert code == 0, out
    assert digests(path) == reference
    assert not list(path.parent.rglob("*.partial")), "litter is swept"


@pytest.mark.timeout(280)
def test_a_job_under_kills_ends_with_the_same_bytes(tmp_path: Path, reference: dict[str, str]) -> None:
    run_under_kills(write_tiny_shot(tmp_path / "shot", FRAMES), 6, 3, reference)


@pytest.fixture
def farm(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler and two workers as processes of their own, as on a farm."""
    file = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler = subprocess.Popen(
        [*dask, "--dashboard-address", "127.0.0.1:0", "--scheduler-file", str(file)], **quiet
    )  # fmt: skip
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1"]
    workers = subprocess.Popen([*worker, "--nworkers", "2", "--host", "127.0.0.1", "--no-dashboard"], **quiet)
    deadline = time.monotonic() + 60
    while not file.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    yield json.loads(file.read_text())["address"], scheduler
    for process in (scheduler, workers):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.timeout(240)
def test_a_lost_scheduler_ends_in_exit_75_and_a_later_run_goes_on(
    tmp_path: Path, reference: dict[str, str], farm: tuple[str, subprocess.Popen[bytes]]
) -> None:
    address, scheduler = farm
    path = write_tiny_shot(tmp_path / "shot", FRAMES)
    process = start(path, "--cluster", address)
    records = path.parent / "out" / "run" / "records"
    deadline = time.monotonic() + 90
    while not list(records.glob("*/*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(scheduler.pid, signal.SIGKILL)
    killed = time.monotonic()
    code, out = finish(process, 60)
    took = time.monotonic() - killed
    assert code == EX_TEMPFAIL, out
    assert "The scheduler is lost" in out
    assert "run the same command again" in out
    assert "Traceback" not in out
    assert not [line for line in out.splitlines() if "distributed" in line or "asyncio" in line]
    assert took < 15, f"took {took:.1f} s"  # 10 s by design, and a slow machine's process exit
    code, out = finish(start(path))
    assert code == 0, out
    assert digests(path) == reference
