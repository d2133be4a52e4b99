"""Progress of a run: bars on a terminal, lines that a farm can parse elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

from yesnt.cli.text import compiling_line, dashboard_lines, done_line, notice_line, seconds, time_text
from yesnt.planning.time_left import TimeLeft, stage_name
from yesnt.runtime.control.open_job import in_open_job


class LineProgress:
    """One line an event, and `progress N%` after each finished task (what farms look for)."""

    def __init__(self, megapixels: float = 1.0) -> None:
        self._total = self._done = 0
        self._time = TimeLeft(megapixels)

    def __enter__(self) -> LineProgress:
        return self

    def __exit__(self, *error: object) -> None:
        sys.stdout.flush()

    def __call__(self, event: Mapping[str, Any]) -> None:
        """Takes one event of the driver."""
        kind = event["event"]
        self._time.apply(event)
        if kind == "plan":
            self._total, self._done = sum(event["stages"].values()), sum(event["reused"].values())
            print(f"{self._total} task{'s' if self._total != 1 else ''}, {self._done} done already", flush=True)
        elif kind == "cluster":
            print(f"{dashboard_lines(event)}\n", end="", flush=True)  # whole, also if an interrupt comes between
        elif notice_line(event):
            print(notice_line(event), flush=True)
        elif kind in ("compiling", "compiled"):
            print(compiling_line(event), flush=True)
        elif kind in ("done", "done_elsewhere"):
            self._done += 1
            line = f"{done_line(event)}\n" if kind == "done" else ""
            print(line + self._progress_lines(), end="", flush=True)
        elif kind in ("retry", "failed", "worker_died", "dead", "skipped"):
            print(f"Frame {event['frames'][0]} {event['stage']} {kind}: {event['reason']}", flush=True)

    def _progress_lines(self) -> str:
        """Lines that tell how far the run is."""
        return f"progress {100 * self._done // max(1, self._total)}%, {time_text(self._time)}\n"


class OpenJobProgress(LineProgress):
    """The same lines, and those that a session of Open Job Description reads."""

    def _progress_lines(self) -> str:
        share = 100 * self._done / max(1, self._total)
        status = f"{self._done} of {self._total} tasks done, {time_text(self._time)}"
        return f"{super()._progress_lines()}openjd_progress: {share:.1f}\nopenjd_status: {status}\n"


def line_progress(megapixels: float = 1.0) -> LineProgress:
    """Progress in lines, as the farm wants it that started this process."""
    return (OpenJobProgress if in_open_job() else LineProgress)(megapixels)


class BarProgress:
    """A bar a stage with rate and time left, and one for the whole run."""

    def __init__(self, megapixels: float = 1.0) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        self._progress = Progress(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TextColumn("{task.fields[left]}"),
        )
        self._time = TimeLeft(megapixels)
        self._whole: Any = None
        self._bars: dict[str, Any] = {}
        self._began: dict[str, float] = {}
        self._count: dict[str, int] = {}

    def __enter__(self) -> BarProgress:
        self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._progress.stop()

    def __call__(self, event: Mapping[str, Any]) -> None:
        """Takes one event of the driver."""
        kind = event["event"]
        self._time.apply(event)
        if kind == "plan":
            self._lay_out(event)
        elif kind == "cluster":
            self._progress.console.print(dashboard_lines(event))
        elif notice_line(event):
            self._progress.console.print(notice_line(event))
        elif kind in ("compiling", "compiled"):
            self._progress.console.print(compiling_line(event))
        elif kind == "start":
            self._began.setdefault(stage_name(event), time.monotonic())
        elif kind == "done":
            self._advance(stage_name(event))
        elif kind in ("retry", "failed", "worker_died", "dead", "skipped"):
            self._progress.console.print(f"Frame {event['frames'][0]} {event['stage']} {kind}: {event['reason']}")

    def _lay_out(self, event: Mapping[str, Any]) -> None:
        for stage, total in event["stages"].items():
            done = event["reused"].get(stage, 0)
            if stage not in self._bars:
                self._bars[stage] = self._progress.add_task(stage, total=total, completed=done, rate="", left="")
            self._progress.update(self._bars[stage], total=total, completed=done)
        total, done = sum(event["stages"].values()), sum(event["reused"].values())
        if self._whole is None:
            self._whole = self._progress.add_task("all", total=total, completed=done, rate="", left="")
        self._progress.update(self._whole, total=total, completed=done)

    def _advance(self, stage: str) -> None:
        self._count[stage] = self._count.get(stage, 0) + 1
        rate = self._count[stage] / max(1e-6, time.monotonic() - self._began.get(stage, time.monotonic()))
        bar, each = self._bars[stage], f"{rate:.1f}/s" if rate >= 1 else f"{1 / rate:.1f} s each"
        self._progress.update(bar, advance=1, rate=each)
        task = self._progress.tasks[self._progress.task_ids.index(bar)]
        self._progress.update(bar, left=f"{seconds((task.remaining or 0) / rate)} left")
        self._progress.update(self._whole, advance=1, left=time_text(self._time))
