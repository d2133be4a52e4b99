"""Prints the plan of a run."""

from __future__ import annotations

from yesnt.cli.text import gigabytes, print_findings, print_table, seconds
from yesnt.inspect.forecast import Forecast


def print_plan(found: Forecast) -> None:
    """A row a stage, then what the scene lets the run leave out."""
    print_table(
        ("stage", "to do", "reuse", "one worker", "peak memory", "disk", "why"),
        (
            (
                row.stage, row.todo, row.reuse, seconds(row.seconds) + ("" if row.measured else " (guess)"),
                gigabytes(row.peak_bytes), gigabytes(row.disk_bytes), row.why,
            )
            for row in found.stages if row.todo or row.reuse
        ),
    )  # fmt: skip
    total = sum(row.seconds for row in found.stages)
    print(f"In all {seconds(total)} on one worker, about {seconds(total / 2)} on two.")
    spent = found.evaluations
    if spent.most:
        print(
            f"Network evaluations: {spent.expected:,} expected ({spent.least:,} to {spent.most:,}; {spent.basis}), "
            f"{spent.fixed:,} with all {spent.samples} members on every frame."
        )
    bands = "" if found.bands == 1 else f", {found.bands} bands of rows"
    if found.sweeps == 0:
        print("Temporal solve: all frames at once.")
    else:
        chunks = f"{found.chunks} chunks, halo {found.halo} frames{bands}"
        print(f"Temporal solve: {chunks}, at most {found.sweeps} exchange sweeps.")
    for line in found.reads:
        print(f"Reads: {line}.")
    for line in found.modelled:
        print(f"Modelled: {line}.")
    for line in found.left_out:
        print(f"Left out: {line}.")
    print_findings(found.notes, found.warnings)
