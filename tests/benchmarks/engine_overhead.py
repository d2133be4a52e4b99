"""What the engine costs beside its kernels, and what a second worker saves: the embedded shot repeated to 64 frames.

    python tests/benchmarks/engine_overhead.py [--frames 64]

Overhead = 1 - kernel seconds / (workers x wall seconds from the first task to the last), with two workers.
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
    frames = parser.parse_args().frames
    with tempfile.TemporaryDirectory() as folder:
        one, two = (measure(Path(folder) / str(n), frames, n) for n in (1, 2))
    print(f"{frames} frames, seconds: one worker {one}, two workers {two}")
    print(
        f"overhead beside kernels, one worker: {1 - one['kernel'] / one['tasks']:.3f} of the wall (asked: under 0.10)"
    )
    print(f"overhead beside kernels, two workers: {1 - two['kernel'] / (2 * two['tasks']):.3f} of the wall")
    print(f"two workers / one worker: {two['wall'] / one['wall']:.3f} of the wall (asked: at most 0.6)")


if __name__ == "__main__":
    main()
