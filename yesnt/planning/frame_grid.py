"""State of every frame of every stage while a run goes on, from the graph and the driver's events."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.frame_ranges import frame_ranges
from yesnt.core.stage_id import StageId
from yesnt.planning.graph import Graph, NodeId
from yesnt.planning.stages import COMPOSITE, STAGES
from yesnt.planning.time_left import TimeLeft

STATES = ("none", "waiting", "running", "done", "failed", "dead")
"""States of a frame of a stage, as numbers in this order; `none`: the stage makes nothing for the frame."""

NONE, WAITING, RUNNING, DONE, FAILED, DEAD = range(len(STATES))


@dataclass
class _Row:
    """Counts of one stage, per position of a frame."""

    total: NDArray[np.int32]
    done: NDArray[np.int32]
    running: NDArray[np.int32]
    lost: NDArray[np.int8]  # FAILED or DEAD where the driver has given up
    tasks: int = 0
    finished: int = 0  # tasks that were done before, or are now


class FrameGrid:
    """Stages by frames; the dashboard and `status --watch` draw it.

    Attributes:
        frames: frame numbers of the shot, ascending.
        lost: (stage, frame) -> `FAILED` or `DEAD`, and why the driver has given the frame up.
        newest: the frame that was delivered last; None before the first.
        running_tasks: tasks that workers have now.
        time: elapsed, and left.

    Args:
        frames: frame numbers of the shot, ascending.
        megapixels: size of a frame, for the first guess of a task's time.
    """

    def __init__(self, frames: Sequence[int], megapixels: float) -> None:
        self.frames = tuple(frames)
        self.lost: dict[tuple[str, int], tuple[int, str]] = {}
        self.newest: int | None = None
        self.running_tasks = 0
        self.time = TimeLeft(megapixels)
        self._position = {frame: i for i, frame in enumerate(self.frames)}
        self._rows: dict[str, _Row] = {}
        self._finished: set[tuple[str, int]] = set()  # (label of the stage, first frame) of every finished task

    def lay_out(self, graph: Graph, done: Iterable[NodeId]) -> None:
        """Begins anew with a graph of which some nodes are done already; reasons of lost frames stay."""
        self.running_tasks = 0
        self._finished = set()
        used = {node.stage.name for node in graph}
        self._rows = {name: self._empty() for name in STAGES if name in used}
        for node in graph:
            row, place = self._rows[node.stage.name], self._places(node.frames)
            row.total[place] += 1
            row.tasks += 1
        for node_id in done:
            node = graph.nodes[node_id]
            self._finish(self._rows[node.stage.name], node.stage.label, node.frames)
        for (stage, frame), (state, reason) in list(self.lost.items()):
            self.lose(stage, frame, state, reason)
        self.time.plan({name: row.tasks - row.finished for name, row in self._rows.items()})

    def lose(self, stage: str, frame: int, state: int, reason: str) -> None:
        """Marks a frame that the driver has given up (`FAILED` or `DEAD`)."""
        self.lost[stage, frame] = state, reason
        row = self._rows.get(stage)
        if row is not None and frame in self._position:
            row.lost[self._position[frame]] = state

    def apply(self, event: Mapping[str, Any]) -> None:
        """Takes one event of the driver."""
        kind = event["event"]
        if kind not in ("start", "done", "retry", "failed", "worker_died", "dead", "deferred", "skipped"):
            return
        name = StageId.parse(str(event["stage"])).name
        if kind == "skipped":
            for frame in event["frames"]:
                self.lose(name, frame, DEAD, event["reason"])
            return
        row, place = self._rows[name], self._places(event["frames"])
        step = 1 if kind == "start" else -1
        row.running[place] = np.maximum(row.running[place] + step, 0)  # who begins late has not seen every start
        self.running_tasks = max(0, self.running_tasks + step)
        if kind != "done" or (event["stage"], event["frames"][0]) not in self._finished:
            self.time.apply(event)
        if kind == "done":
            self._finish(row, str(event["stage"]), event["frames"])
            if name == COMPOSITE.name:
                self.newest = event["frames"][0]
        elif kind in ("failed", "dead"):
            for frame in event["frames"]:
                self.lose(name, frame, FAILED if kind == "failed" else DEAD, event["reason"])

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages, in order."""
        return tuple(self._rows)

    @property
    def finished(self) -> bool:
        """Whether every task is done."""
        return all(row.finished >= row.tasks for row in self._rows.values())

    def states(self, stage: str) -> NDArray[np.int8]:
        """State of every frame of a stage, as indices into `STATES`."""
        row = self._rows[stage]
        states = np.full(len(self.frames), NONE, np.int8)
        states[row.total > 0] = WAITING
        states[row.running > 0] = RUNNING
        states[(row.total > 0) & (row.done >= row.total)] = DONE
        return np.where(row.lost > 0, row.lost, states)

    def summary(self) -> dict[str, Any]:
        """The grid as a plain document: per stage runs of equal state, counts and mean seconds."""
        return {
            "frames": frame_ranges(self.frames),
            "stages": [self._stage_summary(name) for name in self._rows],
            "lost": [{"stage": s, "frame": f, "reason": why} for (s, f), (_, why) in sorted(self.lost.items())],
            "newest": self.newest,
            "seconds_left": self.time.left,
        }

    def _stage_summary(self, name: str) -> dict[str, Any]:
        row, states = self._rows[name], self.states(name)
        edges = np.flatnonzero(np.diff(states)) + 1
        starts = np.concatenate([[0], edges])
        lengths = np.diff(np.concatenate([starts, [len(states)]]))
        return {
            "name": name,
            "runs": [[int(states[start]), int(length)] for start, length in zip(starts, lengths, strict=True)],
            "tasks": row.tasks,
            "finished": row.finished,
            "seconds_each": self.time.mean(name),
        }

    def _finish(self, row: _Row, label: str, frames: Sequence[int]) -> None:
        """Counts a task once: who reads records and events may hear of one twice."""
        if (label, frames[0]) not in self._finished:
            self._finished.add((label, frames[0]))
            row.done[self._places(frames)] += 1
            row.finished += 1

    def _empty(self) -> _Row:
        count = len(self.frames)
        total, done, running = (np.zeros(count, np.int32) for _ in range(3))
        return _Row(total, done, running, np.zeros(count, np.int8))

    def _places(self, frames: Sequence[int]) -> slice | list[int]:
        """Positions of frames; a slice where they follow one another, as those of a node do."""
        first, last = self._position[frames[0]], self._position[frames[-1]]
        if last - first + 1 == len(frames):
            return slice(first, last + 1)
        return [self._position[frame] for frame in frames]
