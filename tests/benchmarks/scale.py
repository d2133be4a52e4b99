"""Where the driver and Dask's scheduler saturate: a whole cluster in one process, whose tasks only sleep.

    python tests/benchmarks/scale.py [--workers 8 64 512] [--scale 1 0.25] [--serial 3] [--plot scale.svg]

The graph is a real shot's, 4 frames a worker. A task sleeps for what its stage took in the embedded shot's records
(`SECONDS`), times the scale. Two times are compared with the one that an engine without any cost would take, which
hands out the same tasks in the same order:

- measured: scheduler, driver and all workers in this process. They share its interpreter lock, so a real cluster
  saturates later than this one.
- predicted: each task takes `--serial` milliseconds of a driver and a scheduler that do one thing at a time, which is
  what they took together on the cluster that `engine_overhead.py` measures.
"""

from __future__ import annotations

import argparse
import heapq
import json
import logging
import time
from pathlib import Path
from typing import Any

from tests.planning.long_shot import long_plan
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node, NodeId
from yesnt.runtime.cluster.worker_settings import dask_settings
from yesnt.runtime.driver.driver import Driver, DriverSettings
from yesnt.runtime.driver.start_order import ReadyNodes
from yesnt.workflows.shot import shot_graph

SECONDS = {
    "decompose": 2.0, "flow": 0.3, "confidence": 0.5, "solve": 1.0, "relight": 1.0, "composite": 0.15, "preview": 0.5,
}  # fmt: skip
"""Of a task, by stage: about the medians of the records of `make demo` (256x384) on one core."""

FRAMES_PER_WORKER = 4


def sleep(scale: float, node: Node) -> dict[str, Any]:
    """A task that takes its time and leaves nothing."""
    seconds = SECONDS[node.stage.name] * scale
    time.sleep(seconds)
    return {"seconds": seconds, "kernel_seconds": seconds, "peak_bytes": 0}


def measure(workers: int, scale: float, serial: float, folder: Path) -> dict[str, float]:
    """Runs one shot on so many workers; returns what it took."""
    import dask
    from distributed import Client, LocalCluster

    graph = shot_graph(long_plan(FRAMES_PER_WORKER * workers, chunk=64, halo=8, sweeps=2))
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with (
        dask.config.set(dask_settings()),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=False,
            protocol="inproc://",
            dashboard_address=None,
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.wait_for_workers(workers)
        driver = Driver(scale, graph, RecordBook(folder), sleep, DriverSettings())
        driver.reuse()
        began, used, own = time.perf_counter(), time.process_time(), time.thread_time()
        outcome = driver.run(client)
        wall = time.perf_counter() - began
        used, own = time.process_time() - used, time.thread_time() - own
    assert outcome.complete
    best, predicted = schedule(graph, workers, scale, 0.0), schedule(graph, workers, scale, serial)
    return {
        "workers": workers, "scale": scale, "tasks": len(graph), "wall": wall, "best": best, "predicted": predicted,
        "tasks_per_second": len(graph) / wall, "driver_ms": 1e3 * own / len(graph), "all_ms": 1e3 * used / len(graph),
    }  # fmt: skip


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
    """Efficiency over workers, a line a scale."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 3.6))
    for scale in sorted({row["scale"] for row in rows}, reverse=True):
        line = [row for row in rows if row["scale"] == scale]
        workers = [row["workers"] for row in line]
        (drawn,) = axes.plot(workers, [r["best"] / r["wall"] for r in line], "o-", label=f"tasks x {scale:g}, measured")
        predicted = [row["best"] / row["predicted"] for row in line]
        axes.plot(workers, predicted, "s--", color=drawn.get_color(), label=f"tasks x {scale:g}, predicted")
    axes.set(xscale="log", xlabel="workers", ylabel="time without engine / time", ylim=(0, 1.05))
    ticks = sorted({row["workers"] for row in rows})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.legend()
    figure.tight_layout()
    figure.savefig(path)


def main() -> None:
    """Command line."""
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, nargs="+", default=[8, 64, 512])
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0, 0.25])
    parser.add_argument("--serial", type=float, default=3.0, help="milliseconds of driver and scheduler per task")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    rows = []
    for scale in chosen.scale:
        for workers in chosen.workers:
            with tempfile.TemporaryDirectory() as folder:
                row = measure(workers, scale, chosen.serial / 1e3, Path(folder))
            rows.append(row)
            print(
                f"{workers:4} workers, tasks x {scale:g}: {row['tasks']:.0f} tasks in {row['wall']:.1f} s; "
                f"without engine {row['best']:.1f} s ({row['best'] / row['wall']:.0%}), "
                f"predicted {row['predicted']:.1f} s ({row['best'] / row['predicted']:.0%}); "
                f"{row['tasks_per_second']:.0f} tasks/s; "
                f"processor per task: driver {row['driver_ms']:.2f} ms, all {row['all_ms']:.2f} ms",
                flush=True,
            )
    if chosen.json:
        chosen.json.write_text(json.dumps(rows, indent=1))
    if chosen.plot:
        plot(rows, chosen.plot)


if __name__ == "__main__":
    main()
