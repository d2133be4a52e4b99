"""Which process on which host: enough to tell, on that host alone, whether it has ended."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_ENDED_STATES = "ZX"
"""States of a process that has ended and was not waited for yet."""


@dataclass(frozen=True)
class ProcessIdentity:
    """A process.

    Attributes:
        host: name of its host, for people.
        pid: its number.
        boot: identifier of the boot of its host's kernel, and of its space of process numbers (a container has its
            own); "" where the system has none.
        start: when it started, in ticks of its kernel; numbers of processes are used again.
    """

    host: str
    pid: int
    boot: str
    start: str

    @classmethod
    def own(cls) -> ProcessIdentity:
        """This process."""
        found = _stat(os.getpid())
        return cls(platform.node(), os.getpid(), _boot(), found[1] if found else "")

    def has_ended(self) -> bool:
        """Whether it is certain that it has ended; False for every process of another host."""
        return self._is_here() and not self._lives()

    def is_running(self) -> bool:
        """Whether it is certain that it runs; False for every process of another host."""
        return self._is_here() and self._lives()

    def _is_here(self) -> bool:
        return bool(self.boot) and self.boot == _boot()

    def _lives(self) -> bool:
        found = _stat(self.pid)
        return found is not None and found[0] not in _ENDED_STATES and found[1] == self.start

    def __str__(self) -> str:
        return f"host {self.host}, pid {self.pid}"


def _boot() -> str:
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    return ""


def _stat(pid: int) -> tuple[str, str] | None:
    """State and start time of a process of this host; None if there is none of this number."""
    try:
        # The name in brackets may hold anything, so fields are counted behind it.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return fields[0], fields[19]
