"""`yesnt trade`: reads options, measures, prints the table and the settings to take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yesnt.cli import text

ShotArgument = Annotated[Path, typer.Argument(metavar="SHOT", help="shot.yaml or its folder")]


def trade(
    shot: ShotArgument,
    error: Annotated[float | None, typer.Option(min=0, help="largest acceptable display error")] = None,
    seconds_per_frame: Annotated[float | None, typer.Option(min=0, help="most processor seconds per frame")] = None,
    frames: Annotated[int, typer.Option(min=2, help="number of consecutive frames to measure")] = 6,
    json: Annotated[bool, typer.Option("--json", help="one JSON document on stdout")] = False,
) -> int:
    """Measure error against time for the speed settings of each stage on this shot; name the cheapest sufficient."""
    import sys

    from yesnt.measure.trade import TradeOptions, run_trade
    from yesnt.runtime.session import Session

    def tell(line: str) -> None:
        print(line, file=sys.stderr)

    document = run_trade(Session(shot), TradeOptions(frames, error, seconds_per_frame), tell)
    if json:
        text.print_json(document)
        return 0 if document["choice"] else 1
    text.print_table(
        ("stage", "setting", "s per frame", "evaluations", "error", "error to truth"),
        (
            (p["stage"], p["name"], f"{p['seconds']:.2f}", f"{p['evaluations']:.0f}" if p["evaluations"] else "",
             f"{p['error']:.5f}", "" if p["truth"] is None else f"{p['truth']:.5f}")
            for p in document["points"]
        ),
    )  # fmt: skip
    choice = document["choice"]
    if choice is None:
        print("No combination keeps within what was asked.")
    else:
        named = ", ".join(f"{stage}: {name}" for stage, name in choice["names"].items())
        print(f"Take {named}: {choice['seconds']:.2f} s per frame, error {choice['error']:.5f} (squares added).")
        print(f"In the job file: {document['job']}")
    print(f"Written: {', '.join(document['files'])}")
    return 0 if choice else 1
