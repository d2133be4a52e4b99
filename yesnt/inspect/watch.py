"""Follows a run from another process: records say what was done before, the event log what happens now."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from yesnt.inspect.run_view import look
from yesnt.planning.frame_grid import DEAD, FrameGrid
from yesnt.runtime.driver.driver import Driver
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node


class Watch:
    """State of a shot as its driver, wherever it runs, brings it on.

    Args:
        path: the job file or its folder.

    Attributes:
        grid: the state; `update` brings it up to date.

    Raises:
        JobError: the job file is wrong, or an input is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._session = path, Session(path, as_run=True)
        job = self._session.job
        self.grid = FrameGrid(job.all_but(), job.width * job.height / 1e6)
        self._log = EventLog(self._session.output.events)
        self._lay_out()

    @property
    def over(self) -> bool:
        """Whether the last run has ended, done or not; False before the first."""
        view = look(self._session.output, 0)
        return view.over and view.state != "none"

    def update(self) -> bool:
        """Reads what the driver has logged since the last call; returns whether there was anything."""
        changed = False
        for event in self._log.read():
            changed = True
            if event["event"] == "plan":  # a new run, or a pass without the frames that were lost
                if self._session.resolved.awaiting or self._session.job.left_out:  # another part of the job begins
                    self._session = Session(self._path, as_run=True)
                self._lay_out()
            else:
                self.grid.apply(event)
        return changed

    def _lay_out(self) -> None:
        session = self._session
        for (stage, frame), reason in session.marked_dead().items():
            self.grid.lose(stage.name, frame, DEAD, reason)
        graph = session.graph()
        self.grid.lay_out(graph, Driver(session.job, graph, session.book, run_node).reuse().reused)


class EventLog:
    """Reads an event log from its present end on.

    Args:
        path: the log, one JSON object a line; it may appear later.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = path.stat().st_size if path.exists() else 0

    def read(self) -> Iterator[dict[str, Any]]:
        """Events of whole lines that were written since the last call."""
        if not self._path.exists():
            return
        with self._path.open("rb") as stream:
            if stream.seek(0, 2) < self._offset:  # the output folder was made anew
                self._offset = 0
            stream.seek(self._offset)
            for line in stream:
                if not line.endswith(b"\n"):
                    return
                self._offset += len(line)
                yield json.loads(line)
