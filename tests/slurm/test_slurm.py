"""Runs through a real Slurm of one node, which these tests start: jobs, lost workers, walltimes, one allocation."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
import yaml

from tests.fake_tasks import A, B, FakeTask, fake_task, runs_of
from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import ClusterLostError
from yesnt.core.shot import Job
from yesnt.io.jobfile import load_shot
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node
from yesnt.runtime.cluster.open_cluster import open_cluster
from yesnt.runtime.driver.driver import Driver, DriverSettings
from yesnt.runtime.launchers.spec import ClusterSpec, read_cluster
from yesnt.runtime.launchers.table import check_cluster, launcher_of

pytestmark = [
    pytest.mark.slurm,
    pytest.mark.timeout(900),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # Dask closes sockets of killed workers late
]

HERE = Path(__file__).parent
COMMANDS = ("slurmctld", "slurmd", "sbatch", "munged")
FRAMES, SIZE = 24, (96, 80)
LIFETIME_SECONDS, RUN_SECONDS, TASK_SECONDS = 60, 360, 3.0


@pytest.fixture(scope="module", autouse=True)
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A private Slurm; needs root and its programs."""
    absent = [name for name in COMMANDS if shutil.which(name) is None]
    if absent or os.geteuid() != 0:
        pytest.skip(f"a private Slurm needs root and {', '.join(COMMANDS)}; absent: {', '.join(absent) or 'root'}")
    folder = tmp_path_factory.mktemp("slurm")
    path = subprocess.run([HERE / "start.sh", folder], check=True, text=True, stdout=subprocess.PIPE).stdout.strip()
    os.environ["SLURM_CONF"] = path
    yield
    subprocess.run([HERE / "stop.sh", folder], check=True)


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch, slurm: None) -> None:
    """Jobs get the environment of whoever submits them, and import this checkout."""
    monkeypatch.setenv("PYTHONPATH", str(HERE.parent.parent))


def profile(folder: Path, **keys: object) -> Path:
    path = folder / "farm.yaml"
    path.write_text(yaml.safe_dump({"kind": "slurm", "memory": "1500MiB", "interface": "lo", **keys}))
    return path


def yesnt(*words: object) -> list[str]:
    return [sys.executable, "-m", "yesnt", *map(str, words)]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a local run delivers."""
    shot = write_tiny_shot(tmp_path_factory.mktemp("local"), FRAMES, SIZE)
    subprocess.run(yesnt("run", shot, "--workers", 2), check=True, stdout=subprocess.DEVNULL)
    return delivered(shot)


def delivered(shot: Path) -> dict[str, bytes]:
    """Bytes of every EXR, and the digests of decoded arrays that the records of all stages hold."""
    output = shot.parent / "out"
    found = {path.name: path.read_bytes() for path in sorted((output / "exr").glob("*.exr"))}
    assert len(found) == FRAMES
    records = sorted((output / "run" / "records").rglob("[0-9]*.json"))
    assert len(records) > 4 * FRAMES
    return found | {
        str(path.relative_to(output)): repr(json.loads(path.read_text())["arrays"]).encode() for path in records
    }


def jobs() -> list[str]:
    return subprocess.run(["squeue", "--noheader", "--format=%A"], check=True, text=True, stdout=-1).stdout.split()


def until(condition: Callable[[], object], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it takes too long"
        time.sleep(0.2)


def worker_processes() -> list[psutil.Process]:
    """Workers proper: children of the nannies that our jobs started."""
    nannies = [
        p for p in psutil.process_iter(["cmdline"]) if "yesnt.runtime.cluster.worker" in (p.info["cmdline"] or [])
    ]
    children = [child for nanny in nannies for child in nanny.children()]
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def test_a_lost_job_and_a_killed_worker_change_no_byte(tmp_path: Path, expected: dict[str, bytes]) -> None:
    shot = write_tiny_shot(tmp_path / "a shot", FRAMES, SIZE)
    run = subprocess.Popen(
        yesnt("run", shot, "--cluster", profile(tmp_path, walltime="10m")), stdout=subprocess.PIPE, text=True
    )
    assert run.stdout is not None
    lines, cancelled, killed = [], [], []
    for line in run.stdout:
        lines.append(line)
        percent = int(found[1]) if (found := re.match(r"progress (\d+)%", line)) else 0
        if percent >= 20 and not cancelled:
            cancelled.append(jobs()[0])
            subprocess.run(["scancel", cancelled[0]], check=True)
        if percent >= 50 and not killed and len(worker_processes()) > 0:
            killed.append(worker_processes()[0])
            killed[0].kill()
    assert run.wait() == 0, "".join(lines[-20:])
    assert cancelled
    assert killed
    assert delivered(shot) == expected
    until(lambda: not jobs(), 30)
    log = (shot.parent / "out" / "run" / "workers" / "launcher.log").read_text()
    assert f"has ended: {cancelled[0]}; it is replaced" in log
    assert list((shot.parent / "out" / "run").glob("tls-*")) == [], "certificates go with the run"


def test_workers_are_replaced_before_their_time_is_over_and_no_task_is_made_twice(tmp_path: Path) -> None:
    job = Job(shot=load_shot(write_tiny_shot(tmp_path / "s")), root=str(tmp_path), frames=(), width=1, height=1)
    count = int(2 * RUN_SECONDS / TASK_SECONDS)
    task = FakeTask(sleep=TASK_SECONDS)
    graph = Graph([Node(A, i, (i,), {"a": i}, (), task) for i in range(count)])
    farm = profile(tmp_path, walltime=f"{2 * LIFETIME_SECONDS}s", drain=f"{LIFETIME_SECONDS}s")
    spec = read_cluster(str(farm)).of_job(False, tmp_path / "run")
    events: list = []
    with open_cluster(spec) as client:
        driver = Driver(job, graph, RecordBook(tmp_path / "records"), fake_task, DriverSettings(), events.append)
        driver.reuse()
        began = time.monotonic()
        outcome = driver.run(client)
    assert time.monotonic() - began >= RUN_SECONDS
    assert outcome.complete
    assert [i for i in range(count) if runs_of(job, A, i) != 1] == [], "work in flight is finished, not repeated"
    assert not [e for e in events if e["event"] in ("worker_died", "dead", "retry")]
    ended = (tmp_path / "run" / "workers" / "launcher.log").read_text().count("has ended")
    assert ended >= 2 * (RUN_SECONDS // LIFETIME_SECONDS - 2), "workers have come and gone"


@pytest.mark.parametrize("mode", ["jobs", "allocation"])
def test_a_submission_leaves_nothing_here_and_delivers_the_same(
    tmp_path: Path, expected: dict[str, bytes], mode: str
) -> None:
    shot = write_tiny_shot(tmp_path / "s", FRAMES, SIZE)
    farm = profile(tmp_path, walltime="10m", mode=mode)
    began = time.monotonic()
    done = subprocess.run(yesnt("submit", shot, "--cluster", farm), check=True, text=True, stdout=subprocess.PIPE)
    assert time.monotonic() - began < 30, "it returns at once"
    assert re.search(r"slurm job \d+", done.stdout), done.stdout
    until(lambda: jobs() == [], 240)
    printed = subprocess.run(yesnt("logs", shot), check=True, text=True, stdout=subprocess.PIPE).stdout
    assert "progress 100%" in printed
    assert delivered(shot) == expected


def test_gpu_tasks_go_to_jobs_that_have_a_gpu(tmp_path: Path) -> None:
    job = Job(shot=load_shot(write_tiny_shot(tmp_path / "s")), root=str(tmp_path), frames=(), width=1, height=1)
    graph = Graph([Node(stage, i, (i,), {"n": i}, (), FakeTask(sleep=0.2)) for stage in (A, B) for i in range(8)])
    farm = profile(tmp_path, walltime="10m", workers=1, gpu={"workers": 1, "type": "fake", "memory": "1500MiB"})
    spec = read_cluster(str(farm)).of_job(True, tmp_path / "run")
    check_cluster(spec)
    settings = DriverSettings(gpu_stages=frozenset({"a"}), pools=launcher_of(spec).pools)
    events: list = []
    with open_cluster(spec) as client:
        driver = Driver(job, graph, RecordBook(tmp_path / "records"), fake_task, settings, events.append)
        driver.reuse()
        assert driver.run(client).complete
        workers = client.scheduler_info(n_workers=-1)["workers"]
        devices = client.run(os.getenv, "CUDA_VISIBLE_DEVICES")
    assert {devices[address] for address, worker in workers.items() if "GPU" in worker["resources"]} == {"0"}
    done = [event for event in events if event["event"] == "done"]
    assert len(done) == 16
    for event in done:
        worker = workers[event["worker"]]
        pool = {"a": "GPU", "b": "CPU"}[event["stage"]]
        assert worker["resources"] == {pool: 1.0}
        assert str(worker["name"]).startswith(pool.lower())


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_run_that_ends_early_leaves_no_job(tmp_path: Path, number: int, status: int) -> None:
    shot = write_tiny_shot(tmp_path / "s", FRAMES, SIZE)
    words = yesnt("run", shot, "--cluster", profile(tmp_path, walltime="10m"))
    with subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        text=True,
        # A shell gives its background jobs an ignored SIGINT, which children would inherit.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if line.startswith("progress 1"):
                run.send_signal(number)
                break
        run.stdout.read()
        assert run.wait() == status
    until(lambda: not jobs(), 120)
    if number == signal.SIGINT:
        assert list((shot.parent / "out" / "run").glob("tls-*")) == []


def test_a_python_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("yesnt.runtime.launchers.top_up.POLL_SECONDS", 0.5)
    monkeypatch.setattr("yesnt.runtime.launchers.top_up.PAUSES", (0.0, 0.0))
    farm = profile(tmp_path, workers=1, python="/no/such/python")
    spec = read_cluster(str(farm)).of_job(False, tmp_path / "run")
    with pytest.raises(ClusterLostError, match=r"3 times in a row: .*/no/such/python: No such file"):
        wait_for_nothing(spec)
    assert jobs() == []


def wait_for_nothing(spec: ClusterSpec) -> None:
    """A run whose driver waits for workers until the scheduler is closed."""
    lost = threading.Event()
    with open_cluster(spec) as client:
        until(lambda: lost.is_set() or client.status != "running", 60)
        raise ClusterLostError("the driver has noticed")
