"""The long form: every scenario with many seeds; resumes, prints a table.

    python -m tests.chaos.run [FOLDER] [--only SCENARIO] [--most N]

FOLDER (default `chaos/`) keeps `results.jsonl`; a seed that passed is not run again. The exit status
is 1 if one failed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.chaos import scenarios
from tests.chaos.jobs import FRAMES, digests, new_job
from tests.in_process import run_here

SEEDS = {
    "kill": 250, "poison": 20, "damage": 1450, "full_disk": 100, "disk_fills": 6, "claims": 20, "two_drivers": 12,
    "odd_surroundings": 8,
}  # fmt: skip
"""Enough for 200 kills that struck and 1,000 flips of a bit; a full disk meets each page of what a job writes."""


class Bench:
    """Runs seeds of scenarios in a folder and keeps what they gave."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder / "results.jsonl"
        self._reference: dict[int, dict[str, str]] = {}
        self._finished: dict[int, Path] = {}

    def finished(self, frames: int) -> Path:
        """A job that is done, and its delivered bytes as the reference."""
        if frames not in self._finished:
            folder = self.folder / f"finished{frames}"
            shutil.rmtree(folder, ignore_errors=True)
            path = self._finished[frames] = new_job(folder, frames)
            run_here(path, "composite")
            self._reference[frames] = digests(path)
        return self._finished[frames]

    def call(self, name: str, seed: int) -> dict[str, Any]:
        """One seed of a scenario."""
        path = self.finished(2 if name == "full_disk" else FRAMES)
        reference, work = self._reference[2 if name == "full_disk" else FRAMES], self.folder / "work"
        shutil.rmtree(work, ignore_errors=True)
        run: Callable[..., dict[str, Any]] = scenarios.SCENARIOS[name]
        if name == "claims":
            return run(seed, work)
        if name in ("damage", "full_disk"):
            return run(seed, path, reference)
        return run(seed, work, reference)

    def passed(self) -> set[tuple[str, int]]:
        """What need not be run again."""
        rows = [json.loads(line) for line in self.log.read_text().splitlines()] if self.log.exists() else []
        return {(row["scenario"], row["seed"]) for row in rows if row["passed"]}

    def keep(self, **row: Any) -> None:
        """Adds a row to the log."""
        with self.log.open("a") as stream:
            stream.write(json.dumps(row) + "\n")

    def table(self) -> str:
        """Passed and failed by scenario, with the last reason."""
        rows = [json.loads(line) for line in self.log.read_text().splitlines()]
        lines = [f"{'scenario':18}{'passed':>8}{'failed':>8}  notes"]
        for name in scenarios.SCENARIOS:
            mine = {row["seed"]: row for row in rows if row["scenario"] == name}.values()
            good, bad = [row for row in mine if row["passed"]], [row for row in mine if not row["passed"]]
            notes = [f"{sum(bool(row['found'].get('struck')) for row in good)} struck"] if name == "kill" else []
            notes += [f"{sum(row['found']['kind'] == 'flip' for row in good)} flips"] if name == "damage" else []
            seconds = [row["found"]["seconds"] for row in good] if name == "poison" else []
            notes += [f"at most {max(seconds)} s"] if seconds else []
            notes += [f"seed {row['seed']}: {row['why']}" for row in bad[:3]]
            lines.append(f"{name:18}{len(good):8}{len(bad):8}  {'; '.join(notes)}")
        return "\n".join(lines)


def run_seed(bench: Bench, name: str, seed: int) -> bool:
    """Runs a seed and keeps the result; whether it passed."""
    began = time.monotonic()
    try:
        found = bench.call(name, seed)
    except Exception as error:  # whatever goes wrong is a result
        bench.keep(scenario=name, seed=seed, passed=False, why=f"{type(error).__name__}: {error}"[:500])
        bench._finished.clear()  # its state is not known
        print(f"{name} {seed} FAILED: {error}", flush=True)
        return False
    bench.keep(scenario=name, seed=seed, passed=True, found=found)
    print(f"{name} {seed} passed in {time.monotonic() - began:.1f} s: {found}", flush=True)
    return True


def main() -> int:
    """Runs what has not passed yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("chaos"))
    parser.add_argument("--only", choices=sorted(SEEDS))
    parser.add_argument("--most", type=int, default=1 << 30, help="seeds of each scenario")
    options = parser.parse_args()
    bench, failed = Bench(options.folder.absolute()), 0
    names = [options.only] if options.only else list(SEEDS)
    if not scenarios.can_mount(bench.folder):
        print("No right to mount a disk: full_disk and disk_fills are left out.")
        names = [name for name in names if name not in ("full_disk", "disk_fills")]
    passed = bench.passed()
    for name in names:
        for seed in range(min(SEEDS[name], options.most)):
            if (name, seed) not in passed:
                failed += not run_seed(bench, name, seed)
    print(bench.table())
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
