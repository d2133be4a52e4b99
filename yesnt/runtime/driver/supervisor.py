"""What may stop a driver from starting tasks: its user, its lease, a shortage, a full disk, failing hosts."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.errors import RunCancelledError
from yesnt.io.commands import Command, take_commands
from yesnt.io.lease import Lease
from yesnt.runtime.driver.host_failures import HostFailures
from yesnt.runtime.driver.shortages import Shortages

Listener = Callable[[Mapping[str, Any]], None]

CHECK_SECONDS = 1.0
"""How often commands, the lease and the room on the disk are looked at."""

ALL_STAGES = ""
"""Stands for all stages in events of shortages."""


@dataclass(frozen=True)
class Watched:
    """What a supervisor looks at; all of it may be absent.

    Attributes:
        runs: identifiers that commands may be addressed to: of the run, and of its submission.
        commands: folder of the commands.
        lease: of the driver.
        disk: folder of the results.
        room: bytes that must be free on its disk for tasks to start.
    """

    runs: tuple[str, ...] = ()
    commands: Path | None = None
    lease: Lease | None = None
    disk: Path | None = None
    room: int = 0


class Supervisor:
    """Decides for one run which tasks may start; lives through all passes of the driver.

    Args:
        watched: files and folders that it looks at.
        tell: called with events: paused, resumed, skip, shortage, shortage_over, host_blocked.
    """

    def __init__(self, watched: Watched = Watched(), tell: Listener = lambda event: None) -> None:
        self._watched, self._tell = watched, tell
        self.hosts = HostFailures()
        self.shortages = Shortages(tell)
        self.paused = False
        self._low = False
        self._skips: list[Command] = []
        self._checked = -CHECK_SECONDS

    def check(self) -> None:
        """Looks at everything, if it is time.

        Raises:
            RunCancelledError: the user cancelled the run.
            LeaseLostError: another driver has taken over.
        """
        now = time.monotonic()
        if now - self._checked < CHECK_SECONDS:
            return
        self._checked = now
        self.confirm()
        if self._watched.commands is not None:
            for command in take_commands(self._watched.commands):
                self._obey(command)
        self._look_for_room()

    def confirm(self) -> None:
        """Makes sure that this driver still holds its lease; called before it writes what only a driver may write.

        Raises:
            LeaseLostError: it does not.
        """
        if self._watched.lease is not None:
            self._watched.lease.confirm()

    def admit(self, stage: str) -> bool:
        """Whether one task of a stage may start now; asked once for each task."""
        return not (self.paused or self._low) and self.shortages.admit(stage)

    def take_skips(self) -> list[Command]:
        """Commands to leave frames out that came since the last call."""
        skips, self._skips = self._skips, []
        return skips

    def block(self, host: str) -> None:
        """Tells that a host gets no more tasks."""
        self._say("host_blocked", host=host, reason=self.hosts.blocked[host])

    def _obey(self, command: Command) -> None:
        if command.run not in self._watched.runs:
            return  # it came too late for an earlier run
        if command.verb == "cancel":
            raise RunCancelledError(
                f"The run was cancelled by {command.by}", do="the same command goes on from what is committed"
            )
        if command.verb == "skip":
            self._skips.append(command)
        elif self.paused != (command.verb == "pause"):
            self.paused = not self.paused
            self._say("paused" if self.paused else "resumed", by=command.by)

    def _look_for_room(self) -> None:
        if self._watched.disk is None:
            return
        free = shutil.disk_usage(self._watched.disk).free
        low = free < self._watched.room
        if low != self._low:
            self._low = low
            sizes = f"{free / 1e9:.2f} GB free on the output's disk, {self._watched.room / 1e9:.2f} GB needed"
            self._say("shortage" if low else "shortage_over", stage=ALL_STAGES, reason=sizes if low else "")

    def _say(self, event: str, **facts: Any) -> None:
        self._tell({"event": event, "time": time.time(), **facts})
