"""What a first run costs: seconds to compile the kernels, and the demo with an empty and with a filled cache.

    python tests/benchmarks/engine_first_run.py [--kernels]

Compiles every unit of runtime/cluster/precompile.py in a fresh process and an empty cache and prints processor seconds
per kernel, callees excluded. Then runs the demo twice, first with an empty cache, and prints the seconds by the clock,
the time until all kernels were compiled, and the longest time without a line of output. `--kernels`: the first part
alone.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from numba.core import event

from yesnt.runtime.cluster.precompile import UNITS


class CompileTimes(event.Listener):
    """Listener of Numba's compiler: processor seconds and number of specialisations by kernel."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.count: Counter[str] = Counter()
        self._stack: list[list[float]] = []

    def on_start(self, event: Any) -> None:
        """Takes the start of a compilation; compilations of callees lie within."""
        self._stack.append([time.process_time(), 0.0])

    def on_end(self, event: Any) -> None:
        """Takes the end of a compilation."""
        began, callees = self._stack.pop()
        spent = time.process_time() - began
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__qualname__}"
        self.seconds[name] += spent - callees
        self.count[name] += 1
        if self._stack:
            self._stack[-1][1] += spent


def compile_units() -> None:
    """Compiles all units in this process and prints what each kernel took."""
    times = CompileTimes()
    event.register("numba:compile", times)
    began = time.process_time()
    for unit in UNITS:
        before = time.process_time()
        unit.compile()
        print(f"{unit.package} {unit.function}: {time.process_time() - before:.1f} s with imports")
    for name, seconds in sorted(times.seconds.items(), key=lambda item: -item[1]):
        print(f"{seconds:7.2f} s  {times.count[name]:2d} x  {name}")
    for package in ("yesnt.relight", "yesnt.temporal", "numba"):
        own = [name for name in times.seconds if name.startswith(package)]
        count = sum(times.count[name] for name in own)
        print(f"{package}: {sum(times.seconds[name] for name in own):.1f} s, {count} specialisations")
    print(f"in all {time.process_time() - began:.1f} processor seconds")


def run_demo(folder: Path, cache: Path) -> tuple[float, float, float]:
    """Runs the demo; returns seconds in all, until the kernels were compiled, and the longest without output."""
    code = "from yesnt.cli import main; main()"
    environment = {**os.environ, "YESNT_CACHE_DIR": str(cache)}
    began = last = time.perf_counter()
    longest, compiled = 0.0, 0.0
    command = [sys.executable, "-c", code, "demo", str(folder)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            now = time.perf_counter()
            longest, last = max(longest, now - last), now
            if line.startswith("compiling"):
                compiled = now - began
    assert process.returncode == 0
    return time.perf_counter() - began, compiled, longest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kernels", action="store_true", help="only compile, do not run the demo")
    parser.add_argument("--in-this-process", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.in_this_process:
        compile_units()
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {**os.environ, "YESNT_CACHE_DIR": str(folder / "kernels")}
        subprocess.run([sys.executable, __file__, "--in-this-process"], env=environment, check=True)
        if options.kernels:
            return
        first, second = (run_demo(folder / demo, folder / "cache") for demo in ("first", "second"))
    for title, (seconds, compiled, longest) in (("first", first), ("second", second)):
        print(f"{title} demo: {seconds:.0f} s, kernels compiled after {compiled:.0f} s, silent {longest:.1f} s at most")
    print(f"first longer than second by {first[0] - second[0]:.0f} s (asked: at most 40 s)")


if __name__ == "__main__":
    main()
