"""Worker groups that are kept by a client process on this machine, such as `ssh` or `srun`."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

from yesnt.runtime.launchers.worker_command import WorkerGroup

STOP_SECONDS = 10.0
LOG_LINES = 6

Process: TypeAlias = "subprocess.Popen[str]"


class Processes:
    """A process of this machine for each group; a token is the process.

    Args:
        command: returns the words that start a group.
        logs: folder of the groups' output.
        first_line: what the process reads first; its input stays open as long as the group is wanted. None: no input.
    """

    def __init__(
        self, command: Callable[[WorkerGroup], Sequence[str]], logs: Path, first_line: str | None = None
    ) -> None:
        self._command, self._logs, self._first_line = command, logs, first_line
        self._paths: dict[int, Path] = {}

    def start(self, group: WorkerGroup) -> Process:
        """Starts the process in a session of its own: Ctrl-C reaches the driver alone, which then ends it."""
        path = self._logs / f"{group.name}.log"
        with path.open("w") as log:
            process = subprocess.Popen(
                self._command(group), stdin=subprocess.DEVNULL if self._first_line is None else subprocess.PIPE,
                stdout=log, stderr=subprocess.STDOUT, text=True, start_new_session=True,
            )  # fmt: skip
        self._paths[process.pid] = path
        if self._first_line is not None and process.stdin is not None:
            with suppress(BrokenPipeError):  # it has ended already, and its log says why
                process.stdin.write(f"{self._first_line}\n")
                process.stdin.flush()
        return process

    def alive(self, tokens: Collection[Process]) -> list[Process]:
        """Processes that run."""
        return [process for process in tokens if process.poll() is None]

    def stop(self, tokens: Collection[Process]) -> None:
        """Asks all to end, then ends those that do not."""
        for process in tokens:
            if process.stdin is None:
                process.terminate()
            else:
                with suppress(BrokenPipeError):
                    process.stdin.close()
        for process in tokens:
            try:
                process.wait(STOP_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def log_of(self, token: Process) -> str:
        """The end of a group's output."""
        return last_lines(self._paths[token.pid])


def last_lines(path: Path) -> str:
    """The end of a log, and where the rest is."""
    try:
        lines = path.read_text(errors="replace").splitlines()[-LOG_LINES:]
    except OSError:
        return f"no log at {path}"
    return " | ".join(line.strip() for line in lines if line.strip()) + f" ({path})"


def shell_words(lines: Sequence[str], command: Sequence[str]) -> list[str]:
    """A command that bash runs after some lines; the command replaces the shell."""
    import shlex

    return ["bash", "-c", "\n".join(["set -e", *lines, f"exec {shlex.join(command)}"])]


def as_any(groups: Sequence[WorkerGroup], source: Processes) -> list[tuple[WorkerGroup, Any]]:
    """Groups that all come from one source."""
    return [(group, source) for group in groups]
