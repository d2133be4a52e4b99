"""State of every frame of every stage, from the records alone: nothing runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from yesnt.inspect.differences import Differences, differences
from yesnt.io.record_index import Entry, RecordIndex
from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import stage_of
from yesnt.runtime.left_out import LeftOut
from yesnt.runtime.session import Session

DONE, STALE, WAITING, DEAD = "done", "stale", "waiting", "dead"


@dataclass(frozen=True)
class FrameState:
    """State of one frame of one stage.

    Attributes:
        stage: label of the stage.
        frame: frame number.
        state: `done`, `stale` (its record is of other inputs or settings, or its file was changed), `waiting` (it was
            not made yet) or `dead` (it killed its workers).
        causes: why it is not done, in words.
        follows: stages whose new results it takes.
    """

    stage: str
    frame: int
    state: str
    causes: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()

    @property
    def why(self) -> str:
        """Causes, and what it follows from, as one text; "" where it is done."""
        return "; ".join([*self.causes, *([f"follows from {', '.join(self.follows)}"] if self.follows else [])])


def states(session: Session, graph: Graph | None = None, index: RecordIndex | None = None) -> list[FrameState]:
    """State of every frame of every stage, in stage order; dead frames at the end."""
    graph, index = graph or session.graph(), index or session.open_index()
    compare = _Comparison()
    found = [_state(index, compare, node, frame) for node in graph for frame in node.frames if not node.transient]
    dead = {(stage.label, frame): why for (stage, frame), why in session.marked_dead().items()}
    lost, reasons = session.job.left_out, LeftOut.read(session.output.run).reasons
    found += [_left_out(stage, frame, reasons[frame]) for frame, stage in lost if (stage, frame) not in dead]
    return found + [FrameState(stage, frame, DEAD, (why,)) for (stage, frame), why in dead.items()]


def _left_out(stage: str, frame: int, reason: str) -> FrameState:
    """A frame that the last run could not make: the next one tries again."""
    return FrameState(stage, frame, WAITING, (f"the last run went on without it: {reason}",))


def _state(index: RecordIndex, compare: _Comparison, node: Node, frame: int) -> FrameState:
    entry, stage = index.find(node.stage, frame), node.stage.label
    if entry is None:
        former = stage_of(node.stage).former_name
        if former and index.find(former, frame) is not None:
            return FrameState(stage, frame, STALE, (f"an older version of yesnt made it, as stage {former!r}",))
        return FrameState(stage, frame, WAITING, ("it was not made yet",))
    if entry.key == node.frame_key(frame):
        damage = index.damage(node.stage, frame).replace(f".{frame:04d}.", ".####.")  # alike for all frames
        return FrameState(stage, frame, STALE, (damage,)) if damage else FrameState(stage, frame, DONE)
    found = compare.of(entry, node)
    return FrameState(stage, frame, STALE, found.causes, found.follows)


class _Comparison:
    """Compares fields; the frames of a chunk, which share them, once."""

    def __init__(self) -> None:
        self._last: tuple[Any, Node | None, Differences] = (None, None, Differences())

    def of(self, entry: Entry, node: Node) -> Differences:
        """Where a record's fields differ from a node's."""
        fields, last_node, found = self._last
        old = {name: value for name, value in entry.fields.items() if name != "frame"}
        if node is not last_node or old != fields:
            found = differences(old, node.fields)
            self._last = (old, node, found)
        return found
