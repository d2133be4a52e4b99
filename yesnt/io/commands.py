"""Commands to a running driver, as small files in `out/run/control/`: from any machine that sees the output.

A command names the run that it is for, so that one that comes too late never reaches the next run.
"""

from __future__ import annotations

import getpass
import json
import os
import platform
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from yesnt.io.durable import PARTIAL, sync_folder

VERBS = ("pause", "resume", "cancel", "skip")


@dataclass(frozen=True)
class Command:
    """What a user asks of a run.

    Attributes:
        verb: one of `VERBS`.
        run: identifier of the run, or of the submission that has not started yet.
        by: user and host that ask.
        stage: stage of `skip`.
        frames: frames of `skip`.
    """

    verb: str
    run: str
    by: str
    stage: str = ""
    frames: tuple[int, ...] = ()


def own_name() -> str:
    """User and host of this process."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a container's user without a name
        user = str(os.getuid())
    return f"{user}@{platform.node()}"


def send_command(folder: Path, command: Command) -> Path:
    """Leaves a command for the driver; returns its file. Commands are numbered, so that their order needs no clock."""
    folder.mkdir(parents=True, exist_ok=True)
    temporary = folder / f".{uuid.uuid4().hex}{PARTIAL}"
    temporary.write_text(json.dumps(asdict(command)))
    try:
        number = max(_numbers(folder), default=0)
        while True:
            number += 1
            path = folder / f"{number:06d}.json"
            with suppress(FileExistsError):
                os.link(temporary, path)
                sync_folder(folder)
                return path
    finally:
        temporary.unlink(missing_ok=True)


def take_commands(folder: Path) -> Iterator[Command]:
    """Commands that wait, in order; each is removed before it is obeyed. Files that are no commands are removed."""
    for number in sorted(_numbers(folder)):
        path = folder / f"{number:06d}.json"
        try:
            document = json.loads(path.read_text())
            command = Command(**{**document, "frames": tuple(document["frames"])})
        except (OSError, ValueError, TypeError, KeyError):
            command = None
        path.unlink(missing_ok=True)
        if command is not None and command.verb in VERBS:
            yield command


def _numbers(folder: Path) -> list[int]:
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries]
    except FileNotFoundError:
        return []
    return [int(name[:-5]) for name in names if name.endswith(".json") and name[:-5].isdigit()]
