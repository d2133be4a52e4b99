"""What the command line adds to a job, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from yesnt.core.errors import UsageError
from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io.jobfile import frames_in_order
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, NodeId
from yesnt.planning.stages import STAGES
from yesnt.runtime.driver.driver import DriverSettings, Outcome
from yesnt.runtime.launchers.spec import ClusterSpec


@dataclass(frozen=True)
class RunOptions:
    """What the command line adds to a job.

    Attributes:
        frames: the frames to deliver, as a range; None: all. Their chunks and halos are made too. `1-100:10` delivers
            all hundred, every tenth one first.
        until: the last stage to run; None: all.
        cluster: where tasks run.
        driver: retries, deaths, priority.
        force: `STAGE` or `STAGE:FRAMES` that are made again with all that uses them, although they are done.
    """

    frames: str | None = None
    until: str | None = None
    cluster: ClusterSpec = field(default_factory=ClusterSpec)
    driver: DriverSettings = field(default_factory=DriverSettings)
    force: tuple[str, ...] = ()


@dataclass
class RunResult:
    """Result of `Session.run`.

    Attributes:
        outcome: of all passes over the graph.
        missing: (stage, frame) -> why it could not be made.
        warnings: of the input checks.
        notes: how files are read where the job leaves it to them.
        output: the output folder.
        dashboard: address of the scheduler's dashboard; "" if no cluster was needed.
    """

    outcome: Outcome = field(default_factory=Outcome)
    missing: dict[tuple[StageId, int], str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    output: Path = Path()
    dashboard: str = ""


@dataclass(frozen=True)
class Forced:
    """Frames of a stage that are made again.

    Attributes:
        stage: name of the stage.
        frames: frame numbers.
    """

    stage: str
    frames: frozenset[int]


def check_stage(name: str | None, where: str) -> None:
    """Refuses a name that is no stage's; None is none.

    Raises:
        UsageError: as said.
    """
    if name is not None and name not in STAGES:
        raise UsageError(f"No stage {name!r}", where, f"one of {', '.join(STAGES)}", "check its spelling")


def wanted_frames(job: Job, text: str | None, where: str = "--frames") -> tuple[int, ...]:
    """Frames of a range in the order in which they are wanted, each once; None: all of the shot.

    Raises:
        UsageError: no range, or frames that the shot has not.
    """
    wanted = job.all_but() if text is None else frames_in_order(text, where)
    unknown = sorted(set(wanted).difference(job.all_but()))
    if unknown:
        raise UsageError(f"The shot has no frame {unknown[0]}", where, job.shot.frames, "choose among these")
    return tuple(wanted)


def wanted_order(job: Job, text: str | None) -> tuple[int, ...]:
    """The order of `wanted_frames`; empty if it is ascending, as without any."""
    wanted = wanted_frames(job, text)
    return () if list(wanted) == sorted(wanted) else wanted


def parse_force(job: Job, text: str) -> Forced:
    """`STAGE` or `STAGE:FRAMES`.

    Raises:
        UsageError: an unknown stage, or frames that the shot has not.
    """
    stage, _, frames = text.partition(":")
    check_stage(stage, f"--force {text}")
    return Forced(stage, frozenset(wanted_frames(job, frames or None, f"--force {text}")))


def forget_with_users(graph: Graph, book: RecordBook, force: Forced) -> int:
    """Forgets the records of forced frames and of all that was made from them; returns how many nodes.

    What was made from them may be as wrong as they are, while its key would say that it is right.
    """
    users = graph.users()
    chosen = [n.id for n in graph if n.stage.name == force.stage and not force.frames.isdisjoint(n.frames)]
    found: set[NodeId] = set(chosen)
    while chosen:
        fresh = [user for user in users[chosen.pop()] if user not in found]
        found.update(fresh)
        chosen.extend(fresh)
    for node_id in found:
        node = graph.nodes[node_id]
        for frame in node.frames if node.stage.name != force.stage else force.frames.intersection(node.frames):
            book.forget(node.stage, frame)
    return len(found)
