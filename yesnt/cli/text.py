"""What the commands print: paragraphs, tables, JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import YesntError
from yesnt.runtime.control.open_job import in_open_job

if TYPE_CHECKING:
    from yesnt.inspect.run_view import RunView
    from yesnt.inspect.status import StatusReport
    from yesnt.planning.time_left import TimeLeft


def print_error(error: YesntError, as_json: bool) -> None:
    """One paragraph on stderr, or one JSON document on stdout."""
    if as_json:
        print_json({"error": {"what": error.what, "where": error.where, "expected": error.expected, "do": error.do}})
    else:
        print(f"yesnt: {error}", file=sys.stderr)
        if in_open_job():
            print(f"openjd_fail: {' '.join(str(error).split())}", flush=True)


def print_findings(notes: Iterable[str], warnings: Iterable[str]) -> None:
    """What the checks found of the inputs: how they are read, then what may be wrong."""
    for line in notes:
        print(f"Inputs: {line}.")
    for line in warnings:
        print(f"Warning: {line}")


def print_json(document: Any) -> None:
    """One JSON document on stdout."""
    print(json_text(document), end="")


def json_text(document: Any) -> str:
    """A JSON document as it is printed."""
    return json.dumps(document, indent=1, sort_keys=True, default=str) + "\n"


def print_table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Left-aligned columns, as wide as they need to be."""
    lines = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def print_status(report: StatusReport) -> None:
    """One row a stage, frames counted by state; below, each cause once with the frames it concerns."""
    kinds = ("done", "stale", "waiting", "dead")
    rows = ((stage, *(counts[kind] for kind in kinds)) for stage, counts in report.counts.items())
    print_table(("stage", *kinds), rows)
    concerned: dict[tuple[str, str], list[str]] = {}
    for group in report.groups:
        if group.state in ("dead", "stale"):
            for cause in group.causes or (f"follows from {', '.join(group.follows)}",):
                concerned.setdefault((group.state, cause), []).append(f"{group.stage} {group.frames}")
    for (state, cause), frames in concerned.items():
        print(f"{state}: {cause}: {'; '.join(frames)}")


def seconds(value: float) -> str:
    """`83.1 s`, `12 min`, `3.4 h`."""
    if value < 120:
        return f"{value:.1f} s"
    return f"{value / 60:.0f} min" if value < 7200 else f"{value / 3600:.1f} h"


def time_text(time: TimeLeft) -> str:
    """`83.1 s elapsed, about 12 min left`."""
    left = time.left
    return f"{seconds(time.elapsed)} elapsed" + ("" if left is None else f", about {seconds(left)} left")


def gigabytes(value: float) -> str:
    """`1.9 GB` or `25 MB`."""
    return f"{value / 1e9:.1f} GB" if value >= 1e9 else f"{value / 1e6:.0f} MB"


def done_line(event: Mapping[str, Any]) -> str:
    """A line that a farm can parse: `Frame 1012 relight done 0.8s 0.61GB`."""
    frames = event["frames"]
    span = str(frames[0]) if len(frames) == 1 else f"{frames[0]}-{frames[-1]}"
    return f"Frame {span} {event['stage']} done {event['seconds']:.1f}s {event['peak_bytes'] / 1e9:.2f}GB"


def dashboard_lines(event: Mapping[str, Any]) -> str:
    """Addresses of Dask's dashboard and, for a shot, of the page of all its frames."""
    page = event.get("page")
    tunnel = event.get("tunnel", "")
    return (
        f"Dask dashboard: {event['dashboard']}"
        + (f"\nFrame grid:     {page}" if page else "")
        + (f"\nFrom elsewhere: {tunnel}" if tunnel else "")
    )


def compiling_line(event: Mapping[str, Any]) -> str:
    """Progress of the first run after an installation or a change of the kernels."""
    line = f"compiling kernels {event['done']}/{event['total']} (once per version), {event['seconds']:.0f} s"
    if event.get("failed"):
        line += f"; a compiler ended with {event['failed'][0]}, tasks compile what they lack"
    return line


def notice_line(event: Mapping[str, Any]) -> str:
    """What happened to a run as a whole; "" for events of single tasks."""
    kind, why = event["event"], event.get("reason", "")
    if kind == "waiting":
        return f"Waiting: {why}"
    if kind == "taken_over":
        return f"Taken over: the driver on {event['owner']} is gone; this one goes on from what is committed"
    if kind == "paused":
        return f"Paused by {event['by']}: tasks under way end, no other starts until `yesnt resume`"
    if kind == "resumed":
        return f"Resumed by {event['by']}"
    if kind == "host_blocked":
        return f"Host {event['host']} gets no more tasks: {why}"
    stage = f"stage {event['stage']}" if event.get("stage") else "all stages"
    if kind == "shortage":
        return f"Shortage: {stage} waits and goes on by itself: {why.rstrip('.')}"
    return f"Shortage is over: {stage} goes on" if kind == "shortage_over" else ""


def run_lines(run: RunView) -> list[str]:
    """State of the driver, a fact a line; none if there was no run."""
    if run.state == "none":
        return []
    where = f" on {run.host}, pid {run.pid}" if run.host else ""
    handed = f" ({run.submission}, {run.job})" if run.submission else ""
    by = f" by {run.by}" if run.by and run.state in ("paused", "queued") else ""
    status = "" if run.exit_status is None else f", exit status {run.exit_status}"
    lines = [f"run: {run.state}{by}{where}{handed}{status}"]
    lines += [f"shortage: {f'stage {stage}' if stage else 'all stages'}: {why}" for stage, why in run.shortages.items()]
    lines += [f"blocked host: {host}: {why}" for host, why in run.blocked_hosts.items()]
    lines += [f"dashboard: {run.dashboard}"] if run.active and run.dashboard else []
    return lines + ([f"error: {run.error}"] if run.error else [])
