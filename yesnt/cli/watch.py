"""`yesnt status --watch`: the frame grid in a terminal."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from yesnt.cli.text import seconds

if TYPE_CHECKING:
    from rich.console import RenderableType

    from yesnt.planning.frame_grid import FrameGrid

REFRESH_SECONDS = 1.0
BAR_CELLS = 50
MOST_LOST = 10
COLORS = ("grey23", "grey50", "yellow", "green", "red", "dark_red")
"""Colours of the states of `frame_grid.STATES`."""


def watch(shot: Path) -> None:
    """Shows the state of a shot once a second until all is done or its run ends; before the first run it waits."""
    from rich.console import Console
    from rich.live import Live

    from yesnt.inspect.watch import Watch

    found = Watch(shot)
    console = Console()
    with Live(draw(found.grid), console=console, auto_refresh=False, transient=False) as live:
        live.refresh()
        while not (found.grid.finished or found.over):
            time.sleep(REFRESH_SECONDS)
            if found.update() and sys.stdout.isatty():
                live.update(draw(found.grid), refresh=True)
        live.update(draw(found.grid), refresh=True)


def draw(grid: FrameGrid) -> RenderableType:
    """A row a stage: the states of its frames from first to last, tasks done, seconds each; below, lost frames."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("stage", "frames, first to last", "tasks", "each"):
        table.add_column(title, no_wrap=True)
    summary = grid.summary()
    for stage in summary["stages"]:
        each = "" if stage["seconds_each"] is None else seconds(stage["seconds_each"])
        table.add_row(stage["name"], _bar(grid, stage["name"]), f"{stage['finished']} of {stage['tasks']}", each)
    lost = [Text(f"{one['stage']} {one['frame']}: {one['reason']}", "red") for one in summary["lost"]]
    if len(lost) > MOST_LOST:
        lost[MOST_LOST:] = [Text(f"and {len(lost) - MOST_LOST} more", "red")]
    return Group(table, Text(_headline(grid)), *lost)


def _headline(grid: FrameGrid) -> str:
    newest = "" if grid.newest is None else f", newest frame {grid.newest}"
    if grid.finished:
        return f"{len(grid.frames)} frames, finished"
    if not grid.running_tasks:
        return f"{len(grid.frames)} frames{newest}; no task runs"
    left = grid.time.left
    return f"{len(grid.frames)} frames{newest}" + ("" if left is None else f", about {seconds(left)} left")


def _bar(grid: FrameGrid, stage: str) -> RenderableType:
    """Cells in frame order; a cell that stands for several frames shows the state that needs most attention."""
    from rich.text import Text

    from yesnt.planning.frame_grid import DEAD, DONE, FAILED, NONE, RUNNING, WAITING

    rank = np.zeros(6, np.int64)
    rank[[NONE, DONE, WAITING, RUNNING, FAILED, DEAD]] = np.arange(6)
    states = grid.states(stage)
    bar = Text()
    for part in np.array_split(states, min(BAR_CELLS, len(states))):
        bar.append("■", COLORS[int(part[np.argmax(rank[part])])])
    return bar
