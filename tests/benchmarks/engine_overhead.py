"""What the engine costs beside its kernels, and what a second worker saves: the embedded shot repeated to 64 frames.

    python tests/benchmarks/engine_overhead.py [--frames 64] [--workers 1 2]

Kernel time is the wall time inside `Workspace.kernel` of every task: the network, flow, solver, light and composite on
arrays in memory, the first call's loading of compiled code included. Reading, decoding, coding, writing, syncing,
imports, waiting, the film and the scheduler are overhead. Overhead = 1 - kernel seconds / (workers x wall seconds), of
the whole run (checks and start of the workers included) and of the time from the first task to the last.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from long_shot import write_long_shot

from yesnt.cluster import ClusterSpec
from yesnt.session import RunOptions, Session


def measure(folder: Path, frames: int, workers: int) -> dict[str, float]:
    session = Session(write_long_shot(folder, frames))
    began = time.perf_counter()
    result = session.run(RunOptions(cluster=ClusterSpec("local", workers)))
    wall = time.perf_counter() - began
    assert not result.missing
    events = [json.loads(line) for line in session.output.events.read_text().splitlines()]
    times = [e["time"] for e in events if e["event"] in ("start", "done")]
    return {"wall": wall, "tasks": max(times) - min(times), "kernel": result.outcome.kernel_seconds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--workers", type=int, nargs="+", default=(1, 2))
    options = parser.parse_args()
    walls = {}
    for workers in options.workers:
        with tempfile.TemporaryDirectory() as folder:
            found = measure(Path(folder) / "shot", options.frames, workers)
        walls[workers] = found["wall"]
        shares = [1 - found["kernel"] / (workers * found[span]) for span in ("wall", "tasks")]
        print(f"{options.frames} frames, {workers} workers: {found['wall']:.1f} s, kernels {found['kernel']:.1f} s")
        print(f"overhead: {shares[0]:.3f} of the run, {shares[1]:.3f} from first task to last (asked: under 0.10)")
    if {1, 2} <= set(walls):
        print(f"two workers / one worker: {walls[2] / walls[1]:.3f} of the wall (asked: at most 0.6)")


if __name__ == "__main__":
    main()
