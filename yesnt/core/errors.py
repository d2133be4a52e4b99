"""Errors that a user can act on: what, where, what was expected, what to do."""

from __future__ import annotations


class YesntError(Exception):
    """An error that is printed as one paragraph.

    Args:
        what: the problem, in one clause.
        where: file, frame, key or line.
        expected: what would have been right.
        do: the next step for the user.
    """

    exit_status = 1

    def __init__(self, what: str, where: str = "", expected: str = "", do: str = "") -> None:
        super().__init__(what, where, expected, do)
        self.what, self.where, self.expected, self.do = what, where, expected, do

    def __str__(self) -> str:
        parts = [self.what]
        if self.where:
            parts.append(f"Where: {self.where}")
        if self.expected:
            parts.append(f"Expected: {self.expected}")
        if self.do:
            parts.append(f"Do: {self.do}")
        return ". ".join(part.rstrip(".") for part in parts) + "."


class JobError(YesntError):
    """The job file or its inputs are wrong; nothing has been written."""


class UsageError(YesntError):
    """The command line is wrong."""

    exit_status = 2


class CorruptError(YesntError):
    """Something that was committed no longer decodes to what its record says."""


class MissingPartError(YesntError):
    """An optional part is not installed; `do` names the extra or the make target."""


class LeaseLostError(YesntError):
    """Another process has taken over what this one was doing; it stops before it writes."""


class RunCancelledError(YesntError):
    """The user cancelled the run from another terminal or machine; what was committed stays."""

    exit_status = 130


class ShortageError(YesntError):
    """A task cannot run now for want of something that comes back: a licence, a busy GPU, room on the disk.

    The driver pauses the task's stage, tries again from time to time, and counts no failure.
    """


class ClusterLostError(YesntError):
    """The scheduler is gone; what was committed stays and `run` resumes from it."""

    exit_status = 75
