"""Keeps the wanted number of worker groups: one that is lost, or whose time is over, is replaced."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from yesnt.core.errors import ClusterLostError, YesntError
from yesnt.runtime.launchers.worker_command import WorkerGroup

POLL_SECONDS = 10.0
"""Often enough for a farm of busy workers, rarely enough for its controller."""

FAILED_STARTS = 3
"""Groups of one slot that end in a row, none of whose workers joined, before the cluster counts as unusable."""

PAUSES = (0.0, 5.0, 20.0)
"""Seconds before a slot is filled again, by the number of failed starts before."""

RUN_UNTIL = "YESNT_RUN_UNTIL"
"""Environment variable of a driver in a job of its own: when it must end, in seconds since the epoch by its clock."""

GRACE_SECONDS = 60.0
"""After that time, workers that still run have this long to finish."""

Token = TypeVar("Token")


class Source(Protocol[Token]):
    """Where worker groups come from."""

    def start(self, group: WorkerGroup) -> Token:
        """Starts a group; returns what identifies it. Raises YesntError or OSError if that is refused."""

    def alive(self, tokens: Collection[Token]) -> Collection[Token] | None:
        """Which of these groups wait or run; None if that cannot be known now."""

    def stop(self, tokens: Collection[Token]) -> None:
        """Ends groups."""

    def log_of(self, token: Token) -> str:
        """The last lines that a group wrote, and where the rest is."""


class Joined(Protocol):
    """Which workers have joined the scheduler."""

    ever: set[str]

    def now(self) -> set[str]:
        """Names of the workers that are connected."""


@dataclass
class _Slot(Generic[Token]):
    """A place for one worker group.

    Attributes:
        group: as it was last started; the name carries its generation.
        source: where its groups come from.
        token: of the group that waits or runs; None: to be filled.
        generation: how often it was filled.
        failed: starts in a row that failed.
        due: when it may be filled, by the monotonic clock.
    """

    group: WorkerGroup
    source: Source[Token]
    token: Token | None = None
    generation: int = 0
    failed: int = 0
    due: float = 0.0
    was_joined: bool = field(default=False)


class TopUp(Generic[Token]):
    """The worker groups of a run.

    Args:
        groups: what is wanted, each with where it comes from.
        joined: the workers that are, and that were, connected to the scheduler.
        log: file that gets a line for each start and loss.
        lose: called once when the cluster is unusable; closes the scheduler, so that the run ends.
        ends_at: by the monotonic clock; no group is started after it, and the cluster is unusable once all have ended.
    """

    def __init__(
        self,
        groups: Sequence[tuple[WorkerGroup, Source[Token]]],
        joined: Joined,
        log: Path | None = None,
        lose: Callable[[], None] = lambda: None,
        ends_at: float | None = None,
    ) -> None:
        self._slots = [_Slot(group, source) for group, source in groups]
        self._joined, self._log, self._lose = joined, log, lose
        self._ends_at = float("inf") if ends_at is None else ends_at
        self._stopped = threading.Event()
        self._problem: YesntError | None = None

    def problem(self) -> YesntError | None:
        """Why no worker can be had; None while that is not known to be so."""
        return self._problem

    def step(self, now: float) -> None:
        """Looks at every slot once and fills those that are empty and due."""
        names = set(self._joined.ever)
        alive = self._alive()
        for slot in self._slots:
            slot.was_joined |= any(_of_group(name, self._name(slot)) for name in names)
            if slot.token is not None and slot.token not in alive:
                self._ended(slot, now)
            if slot.token is None and slot.due <= now < self._ends_at and self._problem is None:
                self._fill(slot, now)
        idle = all(slot.token is None for slot in self._slots)
        if now >= self._ends_at + (0 if idle else GRACE_SECONDS) and self._problem is None:
            self._give_up(ClusterLostError(
                "The time of the driver's own job is over", "the job's walltime", "a walltime that lasts for the run",
                "start it again: it resumes from what is committed (a job of `yesnt submit` does so by itself)",
            ))  # fmt: skip

    def stop(self, wait: Callable[[], None] = lambda: None) -> None:
        """Ends all groups; `wait` returns when no step is under way any more."""
        self._stopped.set()
        wait()
        for source, tokens in self._by_source():
            source.stop(tokens)

    def run(self) -> None:
        """Steps until `stop`, or until the cluster is unusable."""
        while not self._stopped.wait(POLL_SECONDS) and self._problem is None:
            self.step(time.monotonic())

    def _by_source(self) -> list[tuple[Source[Token], list[Token]]]:
        found: dict[int, tuple[Source[Token], list[Token]]] = {}
        for slot in self._slots:
            if slot.token is not None:
                found.setdefault(id(slot.source), (slot.source, []))[1].append(slot.token)
        return list(found.values())

    def _alive(self) -> set[Token]:
        """Groups that wait or run; a source that cannot tell keeps all of its own."""
        alive: set[Token] = set()
        for source, tokens in self._by_source():
            known = source.alive(tokens)
            alive.update(tokens if known is None else known)
        return alive

    def _fill(self, slot: _Slot[Token], now: float) -> None:
        slot.generation, slot.was_joined = slot.generation + 1, False
        group = WorkerGroup(self._name(slot), slot.group.pool, slot.group.processes, slot.group.memory)
        try:
            slot.token = slot.source.start(group)
        except (YesntError, OSError) as error:
            self._tell(f"{group.name} is refused: {error}")
            self._failed(slot, now, str(error))
        else:
            self._tell(f"{group.name} is started: {_label(slot.token)}")

    def _ended(self, slot: _Slot[Token], now: float) -> None:
        token, slot.token = slot.token, None
        assert token is not None
        self._tell(f"{self._name(slot)} has ended: {_label(token)}; it is replaced")
        if slot.was_joined:
            slot.failed, slot.due = 0, now
        else:
            self._failed(slot, now, slot.source.log_of(token))

    def _failed(self, slot: _Slot[Token], now: float, why: str) -> None:
        slot.failed += 1
        slot.due = now + PAUSES[min(slot.failed, len(PAUSES) - 1)]
        if slot.failed < FAILED_STARTS or self._works(slot.group.pool):  # this host or job may get well
            return
        self._give_up(ClusterLostError(
            f"{slot.group.pool} workers end before they join, {FAILED_STARTS} times in a row: "
            f"{why.strip() or 'no output'}",
            self._name(slot), "workers that start and reach the scheduler",
            "correct the cluster profile (python, setup, interface), then run the same command again",
        ))  # fmt: skip

    def _give_up(self, problem: YesntError) -> None:
        self._problem = problem
        self._tell(str(problem))
        self._lose()

    def _works(self, pool: str) -> bool:
        """Whether a worker of the pool is connected."""
        names = self._joined.now()
        groups = [self._name(slot) for slot in self._slots if slot.group.pool == pool]
        return any(_of_group(name, group) for name in names for group in groups)

    def _name(self, slot: _Slot[Token]) -> str:
        return f"{slot.group.name}.{slot.generation}"

    def _tell(self, line: str) -> None:
        if self._log is not None:
            with self._log.open("a", encoding="utf-8") as stream:
                stream.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")


def _of_group(worker: str, group: str) -> bool:
    """Whether a worker's name is a group's, or the group's with the number of a process behind it."""
    return worker == group or worker.startswith(f"{group}-")


def _label(token: object) -> str:
    """What the log calls a group: a job's number, or a process's."""
    return str(getattr(token, "pid", token))


@contextmanager
def topped_up(top_up: TopUp[Token]) -> Iterator[None]:
    """Fills all slots, keeps them filled in a thread, and ends all groups at the end."""
    thread = threading.Thread(target=top_up.run, name="yesnt-top-up", daemon=True)
    try:
        top_up.step(time.monotonic())
        thread.start()
        yield
    finally:
        top_up.stop(lambda: thread.join(timeout=30) if thread.ident is not None else None)
