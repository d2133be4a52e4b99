"""Memory does not grow with length: peak worker memory of a long shot over that of a short one.

python tests/benchmarks/engine_memory.py [--frames 16 256]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from long_shot import write_long_shot

from yesnt.cluster import ClusterSpec
from yesnt.session import RunOptions, Session


def peak(folder: Path, frames: int) -> float:
    """Largest resident memory that any worker reported, MB."""
    # A short chunk gives both shots the same blocks: what is left is what length itself costs.
    job = write_long_shot(
        folder, frames, quality="draft", decompose={"backend": "embedded", "samples": 1}, temporal={"chunk": 4}
    )  # fmt: skip
    session = Session(job)
    assert not session.run(RunOptions(cluster=ClusterSpec("local", 2))).missing
    events = [json.loads(line) for line in session.output.events.read_text().splitlines()]
    return max(e["peak_bytes"] for e in events if e["event"] == "done") / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, nargs=2, default=(16, 256))
    lengths = parser.parse_args().frames
    with tempfile.TemporaryDirectory() as folder:
        peaks = [peak(Path(folder) / str(n), n) for n in lengths]
    print(f"peak worker memory: {lengths[0]} frames {peaks[0]:.0f} MB, {lengths[1]} frames {peaks[1]:.0f} MB")
    print(f"ratio {peaks[1] / peaks[0]:.3f} (asked: at most 1.10)")


if __name__ == "__main__":
    main()
