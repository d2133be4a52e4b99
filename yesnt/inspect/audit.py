"""Questions about a job that run nothing: what is done, what would be done and why, what is damaged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from yesnt.core.errors import CorruptError, UsageError
from yesnt.io.file_digests import file_digest
from yesnt.io.jobfile import parse_frames
from yesnt.io.records import Record, key_of
from yesnt.io.store import FrameStore
from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import STAGES, stage_of
from yesnt.runtime.session import Session

DONE, STALE, WAITING, DEAD = "done", "stale", "waiting", "dead"


@dataclass(frozen=True)
class FrameState:
    """State of one frame of one stage; `why` is "" where it is done."""

    stage: str
    frame: int
    state: str
    why: str


@dataclass(frozen=True)
class Damage:
    """Something committed that is no longer there as it was."""

    stage: str
    frame: int
    what: str


def states(session: Session, graph: Graph | None = None) -> list[FrameState]:
    """State of every frame of every stage, in stage order."""
    graph = graph or session.graph()
    dead = session.marked_dead()
    found = [_state(session, node, frame) for node in graph for frame in node.frames if not node.transient]
    found += [FrameState(stage.label, frame, DEAD, why) for (stage, frame), why in dead.items()]
    return found


def _state(session: Session, node: Node, frame: int) -> FrameState:
    record, stage = session.book.find(node.stage, frame), node.stage.label
    former = stage_of(node.stage).former_name
    if record is None and former and session.book.find(former, frame) is not None:
        return FrameState(stage, frame, STALE, f"an older version of yesnt made it, as stage {former!r}")
    if record is None:
        return FrameState(stage, frame, WAITING, "it was not made yet")
    if record.key == node.frame_key(frame):
        return FrameState(stage, frame, DONE, "")
    version = record.fields.get("version")
    if version != node.fields["version"]:
        why = f"another version of yesnt made it: the stage's version was {version}, is {node.fields['version']}"
        return FrameState(stage, frame, STALE, why)
    return FrameState(stage, frame, STALE, "; ".join(differences(record.fields, node.frame_fields(frame))))


NOT_SET = "not set"
"""What is said of a value that only one of two documents holds: settings at their defaults are not recorded."""


def differences(old: Any, new: Any, path: str = "") -> list[str]:
    """Where two documents differ, in words: `settings.energy.lambda1 was 0.02, is 0.05`."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        keys = sorted(set(old) | set(new), key=str)
        below = (differences(old.get(k, NOT_SET), new.get(k, NOT_SET), f"{path}.{k}" if path else str(k)) for k in keys)
        return [line for lines in below for line in lines]
    if _plain(old) == _plain(new):
        return []
    return [f"{path} was {old}, is {new}"]


def _plain(value: Any) -> Any:
    """JSON gives lists where Python has tuples."""
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def explain(session: Session, frame: int) -> list[FrameState]:
    """The states of one frame through all stages."""
    if frame not in session.job.frames:
        raise UsageError(
            f"The shot has no frame {frame}", "explain FRAME", session.job.shot.frames, "choose among these"
        )
    return [state for state in states(session) if state.frame == frame]


def verify(session: Session) -> list[Damage]:
    """Reads everything that is committed and compares it with its record.

    A record that cannot be read, or whose key is not the hash of its fields, counts as damage as well.
    """
    graph = session.graph()
    store = FrameStore(session.output.store)
    return [damage for node in graph for frame in node.frames for damage in _check(session, store, node, frame)]


def _check(session: Session, store: FrameStore, node: Node, frame: int) -> Iterator[Damage]:
    stage = node.stage.label
    if not session.book.path(stage, frame).exists():
        return
    record = session.book.find(stage, frame)
    if record is None or (_of_this_version(record, node) and key_of(record.fields) != record.key):
        yield Damage(stage, frame, "its record is damaged")
        return
    yield from _check_arrays(session, store, record)
    for name, digest in record.files.items():
        path = session.output.root / name
        if not path.is_file():
            yield Damage(stage, frame, f"{name} is missing")
        elif file_digest(path) != digest:
            yield Damage(stage, frame, f"{name} is not the file that was committed")


def _of_this_version(record: Record, node: Node) -> bool:
    """Whether a record's key is made by today's rules; one of another version is stale, not damaged."""
    return bool(record.fields.get("version") == node.fields["version"])


def _check_arrays(session: Session, store: FrameStore, record: Record) -> Iterator[Damage]:
    for name, digest in record.arrays.items():
        try:
            store.read(name, session.job.position(record.frame), digest)
        except CorruptError as error:
            yield Damage(record.stage, record.frame, error.what)
        except (OSError, KeyError, ValueError) as error:
            yield Damage(record.stage, record.frame, f"array {name} cannot be read ({error})")


def forget(session: Session, stages: list[str], frames: str | None) -> int:
    """Makes frames not done and takes away their marks of death; returns how many records went.

    Raises:
        UsageError: an unknown stage or frame range.
        JobError: a driver runs the job.
    """
    unknown = sorted(set(stages) - set(STAGES))
    if unknown:
        raise UsageError(f"No stage {unknown[0]!r}", "--stage", f"one of {', '.join(STAGES)}", "check its spelling")
    wanted = set(session.job.frames if frames is None else parse_frames(frames, "--frames"))
    with session.output.lock():
        return _forget_marks(session, stages, wanted) + _forget_records(session, stages, wanted)


def _forget_marks(session: Session, stages: list[str], wanted: set[int]) -> int:
    chosen = [(s, f) for s, f in session.marked_dead() if f in wanted and s.name in stages]
    for stage, frame in chosen:
        (session.output.dead / stage.label / f"{frame:04d}.json").unlink()
    return len(chosen)


def _forget_records(session: Session, stages: list[str], wanted: set[int]) -> int:
    nodes = [node for node in session.graph() if node.stage.name in stages]
    chosen = [(node.stage, frame) for node in nodes for frame in wanted.intersection(node.frames)]
    held = [(stage, frame) for stage, frame in chosen if session.book.find(stage, frame)]
    for stage, frame in held:
        session.book.forget(stage, frame)
    return len(held)


def as_json(rows: list[FrameState] | list[Damage]) -> list[dict[str, Any]]:
    """Rows as plain documents."""
    return [asdict(row) for row in rows]
