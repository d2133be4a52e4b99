"""Memory does not grow with length: peak worker memory of a long shot over that of a short one.

python tests/benchmarks/engine_memory.py [--frames 16 256]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from long_shot import write_long_shot

from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session


def peak(folder: Path, frames: int) -> tuple[float, str]:
    """Largest resident memory that any worker reported, MB, and the tasks that raised it last."""
    job = write_long_shot(folder, frames, quality="draft", decompose={"backend": "embedded", "samples": 1})
    session = Session(job)
    assert not session.run(RunOptions(cluster=ClusterSpec("local", 2))).missing
    events = [json.loads(line) for line in session.output.events.read_text().splitlines()]
    done = [e for e in events if e["event"] == "done"]
    return max(e["peak_bytes"] for e in done) / 1e6, "; ".join(risen(done))


def risen(done: list[dict[str, Any]]) -> list[str]:
    """The last five tasks after which a worker's peak stood 10 MB higher than after its task before."""
    seen: dict[int, int] = {}
    lines = []
    for e in done:
        before = seen.get(e["pid"], 0)
        if before and e["peak_bytes"] > before + 10e6:
            lines.append(f"{e['stage']} {e['frames'][0]} {before / 1e6:.0f} -> {e['peak_bytes'] / 1e6:.0f} MB")
        seen[e["pid"]] = max(before, e["peak_bytes"])
    return lines[-5:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, nargs=2, default=(16, 256))
    lengths = parser.parse_args().frames
    with tempfile.TemporaryDirectory() as folder:
        peaks = [peak(Path(folder) / str(n), n) for n in lengths]
    for n, (megabytes, tasks) in zip(lengths, peaks, strict=True):
        print(f"{n} frames: peak worker memory {megabytes:.0f} MB; last raised by {tasks}")
    print(f"ratio {peaks[1][0] / peaks[0][0]:.3f} (asked: at most 1.10)")


if __name__ == "__main__":
    main()
