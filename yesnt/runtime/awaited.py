"""What a run makes before the rest of its job is known: mattes of a capture, pictures from Gaussian fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from yesnt.core.errors import JobError
from yesnt.planning.shot_plan import MATTES, VIEWS, Awaiting

MAKERS: Mapping[str, Awaiting] = {"matte": MATTES, "fit": VIEWS, "mesh": VIEWS, "view": VIEWS}
"""Stages that make what other stages read as input files, and what they make."""


def ends_with(awaiting: Awaiting, until: str | None) -> bool:
    """Whether a run that stops after a stage ends once what is awaited is made."""
    made = MAKERS.get(until or "")
    return made is not None and (awaiting != MATTES or made == MATTES)


def refuse_without_mattes(awaiting: Awaiting, output: Path) -> None:
    """Refuses a job whose mattes are still to be made, for verbs that read mattes.

    Raises:
        JobError: as said.
    """
    if awaiting == MATTES:
        raise JobError(
            "The mattes of this job's capture are made from its pictures, and that is not done yet",
            f"{output / MATTES}, key capture.matting", "mattes that are made and up to date",
            "`yesnt run SHOT --until matte`, or `yesnt run SHOT`, makes them",
        )  # fmt: skip


def refuse_awaiting(awaiting: Awaiting, output: Path, made: Sequence[str]) -> None:
    """Refuses a job whose mattes, or plates from Gaussian fields, are still to be made, for verbs that read plates.

    Raises:
        JobError: as said.
    """
    refuse_without_mattes(awaiting, output)
    if awaiting:
        raise JobError(
            "The plates of this job are rendered from Gaussian fields, and that is not done yet",
            f"{output}: {', '.join(made)}", "pictures that are made and up to date",
            "`yesnt gof render SHOT`, or `yesnt run SHOT`, makes them",
        )  # fmt: skip


def refuse_unchanged(before: Awaiting, awaiting: Awaiting, root: str) -> None:
    """Refuses to make again what was just made.

    Raises:
        JobError: what it was made from has changed meanwhile.
    """
    if before and awaiting == before:
        raise JobError(
            f"What the {before} were made from has changed while the job runs", root,
            "the files that the run began with", "run again: what depends on them is made anew",
        )  # fmt: skip
