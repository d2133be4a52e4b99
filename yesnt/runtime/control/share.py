"""Runs a shot in this process beside other processes that do the same, for farms that start one per range of frames.

There is no driver and no scheduler: leases of tasks keep two processes from the same work, records say what is done.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from yesnt.core.errors import YesntError
from yesnt.io.lease import Observer, take_lease
from yesnt.io.store import FrameStore
from yesnt.planning.graph import Graph, Node, NodeId, stage_counts
from yesnt.runtime.awaited import ends_with
from yesnt.runtime.driver.driver import is_done
from yesnt.runtime.left_out import Missing
from yesnt.runtime.run_options import RunOptions, RunResult
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node

Listener = Callable[[Mapping[str, Any]], None]

LAYOUT = "layout"
"""Lease of the process that lays the frame store out."""

WAIT_SECONDS = 1.0
"""Pause before the records are looked at again where others have all that could be done."""


def run_shared(session: Session, options: RunOptions, listen: Listener = lambda event: None) -> RunResult:
    """Does what the options ask for, but for what other processes are doing at the moment; waits for that.

    A task that fails is tried once more; then its frames, and all that need them, are left out.

    Raises:
        YesntError: bad input, wrong options.
    """
    result = RunResult(output=session.output.root)
    if session.job.left_out:
        session.take_all_frames()
    while session.resolved.awaiting:
        known = -1
        while len(result.missing) > known:  # frames that started from one that failed start from another
            known = len(result.missing)
            _share_graph(session, options, result, listen)
        ends = ends_with(session.resolved.awaiting, options.until)
        if ends or not session.look_again(Missing(dict(result.missing))):
            return result
    _share_graph(session, options, result, listen)
    return result


def _share_graph(session: Session, options: RunOptions, result: RunResult, listen: Listener) -> None:
    """Runs all nodes that are known of now."""
    result.notes = session.checks.notes
    found = session.checks.form(beside_others=True) + session.checks.content()
    result.warnings = list(dict.fromkeys([*result.warnings, *found]))
    result.missing |= session.marked_dead()
    missing = Missing(dict(result.missing))
    plan, graph = session.plan(missing), session.graph(missing)
    graph = graph.closure(session.targets(graph, options))
    lease = take_lease(session.output.leases, LAYOUT, patient=True)
    assert lease is not None, "a patient claim waits"
    try:
        job = session.job
        FrameStore.create(session.output.store, plan.arrays(), job.frames, job.height, job.width)
        session.output.exr.mkdir(parents=True, exist_ok=True)
    finally:
        lease.release()
    _Share(session, graph, result, listen).run()


class _Share:
    """The nodes that are left, and what became of the others."""

    def __init__(self, session: Session, graph: Graph, result: RunResult, listen: Listener) -> None:
        self._session, self._graph, self._result, self._listen = session, graph, result, listen
        self._left = dict(graph.nodes)
        self._tries: dict[NodeId, int] = {}

    def run(self) -> None:
        """Goes through the nodes again and again until none is left."""
        reused = stage_counts(node.id for node in self._take_done())
        self._listen({"event": "plan", "stages": stage_counts(self._graph.nodes), "reused": reused})
        while self._left:
            for node in self._take_done():
                self._tell("done_elsewhere", _about(node))
            ready = [node for node in self._left.values() if self._left.keys().isdisjoint(node.needs)]
            waited = True
            for node in ready:
                if not self._taken(node):
                    self._try(node)
                    waited = False
            if ready and waited:
                time.sleep(WAIT_SECONDS)

    def _take_done(self) -> list[Node]:
        """Nodes that are done since the last call, by whatever process."""
        index = self._session.open_index()
        done = [node for node in self._left.values() if is_done(index, node)]
        for node in done:
            del self._left[node.id]
        return done

    def _taken(self, node: Node) -> bool:
        """Whether another process works on a node now."""
        return not Observer(self._session.output.task_leases, f"{node.stage}.{node.frames[0]:04d}").vacant()

    def _try(self, node: Node) -> None:
        about = _about(node)
        self._tell("start", about)
        try:
            receipt = run_node(self._session.job, node)
        except Exception as error:  # the frame is left out and all others go on
            self._tries[node.id] = self._tries.get(node.id, 0) + 1
            reason = str(error) if isinstance(error, YesntError) else f"{type(error).__name__}: {error}"
            again = not isinstance(error, YesntError) and self._tries[node.id] == 1
            self._tell("retry" if again else "failed", about, reason=reason)
            if not again:
                self._give_up(node, reason)
            return
        self._left.pop(node.id)
        self._result.outcome.done.append(node.id)
        self._tell("done", about, **receipt)

    def _give_up(self, node: Node, reason: str) -> None:
        """Leaves a node out, and all that need it."""
        users = self._graph.users()
        self._result.missing |= {(node.stage, frame): reason for frame in node.frames}
        stack: list[NodeId] = [node.id]
        while stack:
            gone = stack.pop()
            if self._left.pop(gone, None) is not None:
                stack += users[gone]

    def _tell(self, event: str, about: Mapping[str, Any], **facts: Any) -> None:
        self._listen({"event": event, "time": time.time(), **about, **facts})


def _about(node: Node) -> dict[str, Any]:
    return {"stage": node.stage.label, "frames": list(node.frames)}
