"""How long status and plan of a long shot take: `python tests/benchmarks/long_shot.py [FRAMES]` (default 10,000).

Files are hard links to one frame's, records are written without running anything. Every figure is of a process of its
own, its start included.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
sys.path.insert(0, str(ROOT))

from tests.long_shot import pretend_done, write_long_shot  # noqa: E402


def measure(title: str, *arguments: str | Path) -> None:
    """Runs a command and prints its seconds."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "yesnt", *map(str, arguments)], capture_output=True, text=True)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{title}: {wall:.2f} s, of processor {processor:.2f} s; {len(done.stdout)} bytes printed", flush=True)


def main(frames: int) -> None:
    """Prints the table."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_long_shot(Path(folder) / "shot", frames)
        time.sleep(2.5)  # files that have only just changed are hashed again
        measure(f"{frames} frames, first plan", "plan", path)
        measure("second plan", "plan", path)
        pretend_done(path)
        time.sleep(2.5)
        measure("first status", "status", path)
        measure("status, nothing changed", "status", path)
        measure("status --json, nothing changed", "status", path, "--json")
        text = path.read_text()
        assert "texels: 8" in text
        path.write_text(text.replace("texels: 8", "texels: 9", 1))
        measure("status after one changed setting", "status", path)
        measure("plan after one changed setting", "plan", path)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
