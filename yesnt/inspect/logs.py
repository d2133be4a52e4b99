"""What a driver printed and what tasks logged."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from yesnt.core.errors import JobError
from yesnt.inspect.run_view import look
from yesnt.io.output import OutputFolder


def frame_logs(output: OutputFolder, frame: int, stage: str | None) -> list[str]:
    """Lines of the logs of a frame's tasks, each with its stage before it.

    Raises:
        JobError: there are none.
    """
    folder = output.run / "logs"
    files = sorted(folder.glob(f"*/{frame:04d}.log"), key=lambda path: path.stat().st_mtime_ns)
    files = [path for path in files if stage is None or path.parent.name.partition(".")[0] == stage]
    if not files:
        raise JobError(
            f"Frame {frame} has no log", str(folder), "a frame that a task began with", "look at `yesnt status SHOT`"
        )
    return [f"{path.parent.name}: {line}" for path in files for line in path.read_text().splitlines()]


class RunLines:
    """Lines about the last run, as they come: what the driver of a submission printed, else the run's events.

    Args:
        output: the output folder.
        stage: events of this stage only; None: all.
    """

    def __init__(self, output: OutputFolder, stage: str | None = None) -> None:
        self._output, self._stage = output, stage
        printed = look(output, 0).submission and output.driver_log.exists() and stage is None
        self._path = output.driver_log if printed else output.events
        self._offset = 0 if printed else _last_run(output.events)
        self._printed = bool(printed)

    def fresh(self) -> Iterator[str]:
        """Whole lines that were added since the last call."""
        for line in self._added():
            if self._printed:
                yield line
            else:
                yield from self._of_event(json.loads(line))

    def _added(self) -> Iterator[str]:
        if not self._path.exists():
            return
        with self._path.open("rb") as stream:
            stream.seek(self._offset)
            for line in stream:
                if not line.endswith(b"\n"):
                    return
                self._offset += len(line)
                yield line.decode(errors="replace").rstrip("\n")

    def _of_event(self, event: dict[str, Any]) -> Iterator[str]:
        stage = str(event.get("stage", ""))
        if self._stage is None or stage.partition(".")[0] == self._stage:
            yield " ".join([event["event"], *(f"{name}={_short(v)}" for name, v in event.items() if name != "event")])


def _short(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else json.dumps(value, separators=(",", ":"))


def _last_run(events: Path) -> int:
    """Where the events of the last run begin."""
    offset = found = 0
    if events.exists():
        with events.open("rb") as stream:
            for line in stream:
                if line.startswith(b'{"event": "run"'):
                    found = offset
                offset += len(line)
    return found
