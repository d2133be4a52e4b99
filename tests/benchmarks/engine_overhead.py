"""What the engine costs beside its kernels, and what a second worker saves: the embedded shot repeated to 64 frames.

    python tests/benchmarks/engine_overhead.py [--frames 64] [--workers 1 2]

Kernel time is the time inside `Workspace.kernel` of every task: network, flow, confidence, solver, light and composite
on arrays in memory, the first call's loading of compiled code included. Reading, decoding, coding, writing, syncing,
imports, waiting, preview and scheduler are overhead. Overhead = 1 - kernel seconds / (workers x wall seconds), of
the whole run (checks and start of the workers included) and of the time from the first task to the last.

The same in processor seconds, which other programs on the machine hardly change: what workers and driver spend beside
kernels.

A machine that cannot be kept quiet for long measures in pieces: `--keep FOLDER --until trust`, then `--keep FOLDER`,
and again for each `--workers`; start and end of the workers count once. `--keep FOLDER --show` prints what is there.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from long_shot import write_long_shot

from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session


def measure(folder: Path, frames: int, workers: int, until: str | None) -> None:
    """Runs what is left up to a stage and adds what it took to the folder's list of pieces."""
    shot = folder / f"{frames}-{workers}"
    job = shot / "shot.yaml" if shot.exists() else write_long_shot(shot, frames)
    driver, began, events = _processor(), time.perf_counter(), []
    result = Session(job).run(RunOptions(until=until, cluster=ClusterSpec("local", workers)), events.append)
    wall = time.perf_counter() - began
    assert not result.missing
    piece = {"until": until, "wall": wall, "driver_processor": _processor() - driver} | _spans(events)
    pieces = _pieces(shot)
    (shot / "pieces.json").write_text(json.dumps([*pieces, piece], indent=1))


def _spans(events: list[dict[str, Any]]) -> dict[str, float]:
    done = [e for e in events if e["event"] == "done"]
    times = [e["time"] for e in events if e["event"] in ("start", "done")]
    workers = {e["pid"]: e["worker_processor_seconds"] for e in done}  # of a process so far: the last one counts
    return {
        "tasks": max(times) - min(times),
        "kernel": sum(e["kernel_seconds"] for e in done),
        "kernel_processor": sum(e["kernel_processor_seconds"] for e in done),
        "worker_processor": sum(workers.values()),
    }


def _processor() -> float:
    used = os.times()
    return used.user + used.system


def _pieces(shot: Path) -> list[dict[str, float]]:
    path = shot / "pieces.json"
    return json.loads(path.read_text()) if path.exists() else []


def show(folder: Path, frames: int, workers: tuple[int, ...]) -> None:
    """Prints overhead for each number of workers, and what the second one saves."""
    walls = {}
    for count in workers:
        pieces = _pieces(folder / f"{frames}-{count}")
        if not pieces or pieces[-1]["until"] is not None:
            continue
        total = {name: sum(piece[name] for piece in pieces) for name in pieces[0] if name != "until"}
        walls[count] = pieces[0]["wall"] + total["tasks"] - pieces[0]["tasks"]
        shares = [1 - total["kernel"] / (count * span) for span in (walls[count], total["tasks"])]
        head = f"{frames} frames, {count} workers: {walls[count]:.1f} s in {len(pieces)} pieces"
        print(f"{head}, kernels {total['kernel']:.1f} s")
        print(f"overhead: {shares[0]:.3f} of the run, {shares[1]:.3f} from first task to last (asked: under 0.10)")
        spent, kernels = total["driver_processor"] + total["worker_processor"], total["kernel_processor"]
        print(f"processor: {1 - kernels / spent:.3f} beside kernels, {(spent - kernels) / frames:.3f} s a frame")
    if {1, 2} <= set(walls):
        print(f"two workers / one worker: {walls[2] / walls[1]:.3f} of the wall (asked: at most 0.6)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--workers", type=int, nargs="+", default=(1, 2))
    parser.add_argument("--until", help="stop after this stage; what follows is another piece")
    parser.add_argument("--keep", type=Path, help="folder of the shots and of what was measured")
    parser.add_argument("--show", action="store_true", help="measure nothing more")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        for workers in () if options.show else options.workers:
            measure(folder, options.frames, workers, options.until)
        show(folder, options.frames, (1, 2) if options.keep else tuple(options.workers))


if __name__ == "__main__":
    main()
