"""What driver and scheduler cost in a long run: 10,000 frames of fake work on two workers.

    python tests/benchmarks/driver_load.py [--frames 10000] [--profile FILE]

Prints the processor time of driver and scheduler per frame over all stages, their peak memory, the time from the start
of the command to its first task, and the time that a second run of the finished job takes. Tasks commit their records
and do nothing else, so that nothing hides the driver.
"""

from __future__ import annotations

import argparse
import cProfile
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.long_shot import write_long_shot  # noqa: E402
from yesnt.core.shot import Job  # noqa: E402
from yesnt.io.output import OutputFolder  # noqa: E402
from yesnt.io.records import Record, RecordBook  # noqa: E402
from yesnt.planning.graph import Node  # noqa: E402

TIMED = "--timed"


def fake_node(job: Job, node: Node) -> dict[str, Any]:
    """Commits the records of a node, and makes nothing."""
    began = time.perf_counter()
    output = OutputFolder.of(job)
    book = RecordBook(output.records, output.root)
    for frame in node.frames:
        path = book.path(node.stage, frame)
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            record = Record(node.stage.label, frame, node.frame_key(frame), node.frame_fields(frame))
            write_at_once(path, vars(record))
    seconds = time.perf_counter() - began
    return {"seconds": seconds, "kernel_seconds": seconds, "peak_bytes": 0}


def write_at_once(path: Path, document: dict[str, Any]) -> None:
    """A record without waiting for the disk, which is not measured here."""
    import json
    import os

    temporary = path.with_suffix(f".{os.getpid()}.partial")
    temporary.write_text(json.dumps(document, default=dict))
    os.replace(temporary, path)


def drive(path: Path, scheduler: str, profile: str) -> None:
    """Runs the job in this process, as `yesnt run` does, and prints figures of this process."""
    began = psutil.Process().create_time()
    from tests.benchmarks import driver_load  # by its name, which workers can import
    from yesnt.runtime import session as session_module
    from yesnt.runtime.launchers.spec import ClusterSpec
    from yesnt.runtime.run_options import RunOptions

    session_module.run_node = driver_load.fake_node  # type: ignore[attr-defined]
    first: list[float] = []

    def listen(event: Any) -> None:
        if event["event"] == "start" and not first:
            first.append(time.time() - began)

    profiler = cProfile.Profile()
    if profile:
        profiler.enable()
    result = session_module.Session(path).run(RunOptions(cluster=ClusterSpec(scheduler)), listen)
    if profile:
        profiler.disable()
        profiler.dump_stats(profile)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    print(f"first {first[0] if first else -1:.2f}")
    print(f"seconds {time.time() - began:.2f}")
    print(f"processor {usage.ru_utime + usage.ru_stime:.2f}")
    print(f"peak {usage.ru_maxrss * 1024}")
    print(f"tasks {len(result.outcome.done)}")


def timed(path: Path, scheduler: str, profile: str = "") -> dict[str, float]:
    """Figures of a driver process."""
    command = [sys.executable, __file__, TIMED, str(path), scheduler, profile]
    out = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout
    words = (line.split() for line in out.splitlines())
    return {row[0]: float(row[1]) for row in words if len(row) == 2}


def measure(folder: Path, frames: int, profile: str) -> None:
    path = write_long_shot(folder / "shot", frames)
    subprocess.run([sys.executable, "-m", "yesnt", "plan", str(path)], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    file = folder / "scheduler.json"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler = subprocess.Popen([*dask, "--dashboard-address", "127.0.0.1:0", "--scheduler-file", str(file)], **quiet)
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1"]
    workers = subprocess.Popen([*worker, "--nworkers", "2", "--host", "127.0.0.1", "--no-dashboard"], **quiet)
    try:
        while not file.exists():
            time.sleep(0.1)
        time.sleep(10)  # workers import before they are measured
        import json

        address = json.loads(file.read_text())["address"]
        before = psutil.Process(scheduler.pid).cpu_times()
        run = timed(path, address, profile)
        after, memory = psutil.Process(scheduler.pid).cpu_times(), psutil.Process(scheduler.pid).memory_info()
        again = timed(path, address)
    finally:
        for process in (workers, scheduler):
            process.terminate()
            process.wait()
    spent = after.user + after.system - before.user - before.system
    print(f"{frames} frames, {run['tasks']:.0f} tasks, {run['seconds']:.0f} s")
    each = 1000 / frames
    together = (run["processor"] + spent) * each
    print(f"driver {run['processor'] * each:.2f} ms a frame, scheduler {spent * each:.2f}, together {together:.2f}")
    print(f"driver {run['peak'] / 1e6:.0f} MB at most, scheduler {memory.rss / 1e6:.0f} MB at the end")
    print(f"first task after {run['first']:.1f} s; second run of the finished job {again['seconds']:.1f} s")


def main() -> None:
    if len(sys.argv) > 1 and sys.argv[1] == TIMED:
        drive(Path(sys.argv[2]), sys.argv[3], sys.argv[4])
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--profile", default="", help="write a cProfile of the driver to this file")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder), options.frames, options.profile)


if __name__ == "__main__":
    main()
