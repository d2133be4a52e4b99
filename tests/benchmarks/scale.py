"""Where the driver and Dask's scheduler saturate: a whole cluster on this machine, whose tasks only sleep.

    python tests/benchmarks/scale.py [--workers 8 64 512] [--scale 1 0.25] [--json FILE] [--plot FILE.svg]
    python tests/benchmarks/scale.py --draw FILE.json --plot FILE.svg

The graph is a real shot's, 4 frames a worker. A task sleeps for what its stage took in the embedded shot's records
(`SECONDS`), times the scale. Two times are compared with the one that an engine without any cost would take, which
hands out the same tasks in the same order:

- measured: the driver in this process, the scheduler in one of its own, and all workers together in a third, which
  share its interpreter lock and this machine's cores. A real cluster saturates later.
- predicted: each task takes the processor time that the driver or the scheduler took for it, whichever took more; they
  do one task after the other, and everything else is free.
"""

from __future__ import annotations

import argparse
import asyncio
import heapq
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.planning.long_shot import long_plan  # noqa: E402
from yesnt.io.records import RecordBook  # noqa: E402
from yesnt.planning.graph import Graph, Node, NodeId  # noqa: E402
from yesnt.runtime.cluster.worker_settings import dask_settings  # noqa: E402
from yesnt.runtime.driver.driver import Driver, DriverSettings  # noqa: E402
from yesnt.runtime.driver.start_order import ReadyNodes  # noqa: E402
from yesnt.workflows.shot import shot_graph  # noqa: E402

SECONDS = {
    "decompose": 2.0, "flow": 0.3, "confidence": 0.5, "solve": 1.0, "relight": 1.0, "composite": 0.15, "preview": 0.5,
}  # fmt: skip
"""Of a task, by stage: about the medians of the records of `make demo` (256x384) on one core."""

FRAMES_PER_WORKER = 4
SERVE = "--serve"


def sleep(scale: float, node: Node) -> dict[str, Any]:
    """A task that takes its time and leaves nothing."""
    seconds = SECONDS[node.stage.name] * scale
    time.sleep(seconds)
    return {"seconds": seconds, "kernel_seconds": seconds, "peak_bytes": 0}


def measure(workers: int, scale: float, folder: Path) -> dict[str, float]:
    """Runs one shot on so many workers; returns what it took."""
    import dask
    from distributed import Client

    from tests.benchmarks import scale as module  # by its name, which workers can import

    graph = shot_graph(long_plan(FRAMES_PER_WORKER * workers, chunk=64, halo=8, sweeps=2))
    with dask.config.set(dask_settings()), processes(workers, folder) as (address, scheduler):
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(workers)
            driver = Driver(scale, graph, RecordBook(folder), module.sleep, DriverSettings())
            driver.reuse()
            began, before, own = time.perf_counter(), scheduler.cpu_times(), time.process_time()
            outcome = driver.run(client)
            wall, after, own = time.perf_counter() - began, scheduler.cpu_times(), time.process_time() - own
    assert outcome.complete
    each = {"driver": own / len(graph), "scheduler": (sum(after[:2]) - sum(before[:2])) / len(graph)}
    best, predicted = schedule(graph, workers, scale, 0.0), schedule(graph, workers, scale, max(each.values()))
    return {
        "workers": workers, "scale": scale, "tasks": len(graph), "wall": wall, "best": best, "predicted": predicted,
        **{f"{name}_ms": 1e3 * seconds for name, seconds in each.items()},
    }  # fmt: skip


@contextmanager
def processes(workers: int, folder: Path) -> Iterator[tuple[str, psutil.Process]]:
    """A scheduler and a process with all workers; yields the scheduler's address and its process."""
    file = folder / "scheduler.json"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    words = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    scheduler = subprocess.Popen([sys.executable, "-m", "yesnt.runtime.cluster.scheduler", *words], **quiet)
    try:
        while not file.exists():
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        others = subprocess.Popen(
            [sys.executable, "-m", "tests.benchmarks.scale", SERVE, address, str(workers)], **quiet
        )
        try:
            yield address, psutil.Process(scheduler.pid)
        finally:
            others.kill()
            others.wait()
    finally:
        scheduler.kill()
        scheduler.wait()


async def serve(address: str, workers: int) -> None:
    """Runs so many workers in this process."""
    import dask
    from distributed import Worker

    dask.config.set(dask_settings())
    started = [Worker(address, nthreads=1, memory_limit=0, dashboard=False, validate=False) for _ in range(workers)]
    for worker in started:
        await worker
    await asyncio.gather(*(worker.finished() for worker in started))


def schedule(graph: Graph, workers: int, scale: float, serial: float) -> float:
    """Seconds of a run by the driver's order, where handing out a task takes `serial` seconds of one server."""
    users = graph.users()
    waiting = {node.id: len(node.needs) for node in graph}
    ready = ReadyNodes(graph, users)
    for node in graph:
        if not node.needs:
            ready.push(node.id)
    running: list[tuple[float, int, NodeId]] = []
    handed, now, server = 0, 0.0, 0.0
    while True:
        while len(running) < workers and (node_id := ready.pop(lambda stage: True)) is not None:
            server, handed = max(server, now) + serial, handed + 1
            heapq.heappush(running, (server + SECONDS[node_id[0].name] * scale, handed, node_id))
        if not running:
            return now
        now, _, node_id = heapq.heappop(running)
        for user in users[node_id]:
            waiting[user] -= 1
            if not waiting[user]:
                ready.push(user)


def plot(rows: list[dict[str, float]], path: Path) -> None:
    """Speed compared with an engine without cost, over workers: measured solid, predicted dashed; a colour a scale."""
    ticks, colours = sorted({row["workers"] for row in rows}), ("#0072b2", "#d55e00", "#009e73")
    parts = [f'<text x="{_x(tick, ticks)}" y="255" text-anchor="middle">{tick:g} workers</text>' for tick in ticks]
    parts += [f'<text x="44" y="{_y(share) + 4}" text-anchor="end">{share:.0%}</text>' for share in (0, 0.5, 1)]
    parts += [f'<path d="M50 {_y(share)}H500" stroke="#ccc"/>' for share in (0, 0.5, 1)]
    scales = sorted({row["scale"] for row in rows}, reverse=True)
    for i, (colour, scale) in enumerate(zip(colours, scales, strict=False)):
        line = [row for row in rows if row["scale"] == scale]
        for name, dash in (("wall", ""), ("predicted", "5 4")):
            points = " ".join(f"{_x(r['workers'], ticks)},{_y(r['best'] / r[name])}" for r in line)
            drawn = f'fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"'
            parts.append(f'<polyline points="{points}" {drawn}/>')
        label = f"tasks x {scale:g}: measured, predicted (dashed)"
        parts.append(f'<text x="60" y="{200 + 16 * i}" fill="{colour}">{label}</text>')
    style = 'font-family="sans-serif" font-size="12"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 540 270" {style}>'
    path.write_text(f'{svg}<rect width="540" height="270" fill="#fff"/>{"".join(parts)}</svg>\n')


def _x(workers: float, ticks: list[float]) -> float:
    return round(80 + 380 * math.log(workers / ticks[0]) / max(1e-9, math.log(ticks[-1] / ticks[0])), 1)


def _y(share: float) -> float:
    return round(235 - 210 * share, 1)


def main() -> None:
    """Command line."""
    if sys.argv[1:2] == [SERVE]:
        asyncio.run(serve(sys.argv[2], int(sys.argv[3])))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, nargs="+", default=[8, 64, 512])
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0, 0.25])
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--draw", type=Path, help="what an earlier run wrote; nothing is measured")
    chosen = parser.parse_args()
    if chosen.draw:
        plot(json.loads(chosen.draw.read_text()), chosen.plot)
        return
    rows = []
    for scale in chosen.scale:
        for workers in chosen.workers:
            with tempfile.TemporaryDirectory() as folder:
                row = measure(workers, scale, Path(folder))
            rows.append(row)
            print(
                f"{workers:4} workers, tasks x {scale:g}: {row['tasks']:.0f} tasks in {row['wall']:.1f} s; "
                f"without engine {row['best']:.1f} s ({row['best'] / row['wall']:.0%}), "
                f"predicted {row['predicted']:.1f} s ({row['best'] / row['predicted']:.0%}); "
                f"{row['tasks'] / row['wall']:.0f} tasks/s; "
                f"processor per task: driver {row['driver_ms']:.2f} ms, scheduler {row['scheduler_ms']:.2f} ms",
                flush=True,
            )
    if chosen.json:
        chosen.json.write_text(json.dumps(rows, indent=1))
    if chosen.plot:
        plot(rows, chosen.plot)


if __name__ == "__main__":
    main()
