"""Runs a graph of tasks on a Dask cluster: order, retries, dead workers, resume.

The driver submits only as many tasks as the cluster has worker threads. Completed work is read from the commit records
alone, so a driver, a worker or a scheduler may vanish at any moment, and the next run continues from the records.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from yesnt.core.errors import LeaseLostError, MissingPartError, ShortageError, YesntError
from yesnt.core.fault_points import fault_point
from yesnt.core.stage_id import StageId
from yesnt.io.dead_marks import SKIPPED
from yesnt.io.durable import is_full
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node, NodeId
from yesnt.runtime.driver.attempt import attempt, recorded, worker_of
from yesnt.runtime.driver.completions import Completions
from yesnt.runtime.driver.event_queue import EventQueue, Receipt
from yesnt.runtime.driver.packed import Packed
from yesnt.runtime.driver.scheduler_watch import SchedulerWatch, lost, no_worker_errors, received, without_workers
from yesnt.runtime.driver.start_order import ReadyNodes
from yesnt.runtime.driver.supervisor import Supervisor
from yesnt.runtime.driver.worker_pools import WorkerPools

if TYPE_CHECKING:
    from distributed import Client

Task = Callable[[Any, Node], Receipt]
Listener = Callable[[Mapping[str, Any]], None]

WAIT_SECONDS = 0.5
"""The driver looks around at least this often while no task ends."""


@dataclass(frozen=True)
class DriverSettings:
    """How failures are handled.

    Attributes:
        retries: how often a task that raised an exception is run again.
        deaths: a node is dead after its worker died this often while the node was the only task on it.
        order: frames in the order in which they are wanted; empty: ascending.
        priority: of the tasks among those of other runs on the same scheduler; higher ones go first.
        gpu_stages: stages that go to GPU workers where there are any; none: every worker takes every task.
        pools: resources that the cluster's launcher starts workers for; empty: unknown.
    """

    retries: int = 1
    deaths: int = 2
    order: tuple[int, ...] = ()
    priority: int = 0
    gpu_stages: frozenset[str] = frozenset()
    pools: frozenset[str] = frozenset()


@dataclass
class Outcome:
    """Result of a run.

    Attributes:
        done: nodes that ran to their end.
        reused: nodes that were done before.
        failed: node -> error of its last attempt.
        dead: node -> reason; its workers died.
        blocked: nodes that were not run because a node they need failed or died.
        busy_seconds: sum over tasks.
        kernel_seconds: the part of it that tasks spent in kernels.
    """

    done: list[NodeId] = field(default_factory=list)
    reused: list[NodeId] = field(default_factory=list)
    failed: dict[NodeId, str] = field(default_factory=dict)
    dead: dict[NodeId, str] = field(default_factory=dict)
    blocked: list[NodeId] = field(default_factory=list)
    busy_seconds: float = 0.0
    kernel_seconds: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether every node is done."""
        return not (self.failed or self.dead or self.blocked)


class Records(Protocol):
    """What knows whether a frame is done: the records themselves, or their index."""

    def done(self, stage: StageId, frame: int, key: str) -> Any:
        """Something true if the frame's record holds this key and its files are those that were committed."""


def is_done(records: Records, node: Node) -> bool:
    """Whether every frame of a node has a record that holds its key."""
    return all(records.done(node.stage, frame, node.frame_key(frame)) for frame in node.frames)


class Driver:
    """Runs the nodes of a graph that have no record yet.

    Args:
        context: sent with every task, such as the job; small.
        graph: nodes, each after those that it needs.
        book: the commit records.
        task: importable function that runs a node on a worker.
        settings: retries and deaths.
        listen: called with a small dictionary for every event: start, done, retry, failed, worker_died, dead, deferred,
            skipped, waiting.
        supervisor: says which tasks may start; None: all.
    """

    def __init__(
        self,
        context: Any,
        graph: Graph,
        book: RecordBook,
        task: Task,
        settings: DriverSettings | None = None,
        listen: Listener = lambda event: None,
        supervisor: Supervisor | None = None,
    ) -> None:
        self._context, self._graph, self._book, self._task = Packed.of(context), graph, book, task
        self._settings, self._listen = settings or DriverSettings(), listen
        self._supervisor = supervisor or Supervisor(tell=listen)
        self._pools = WorkerPools(self._settings.gpu_stages, self._settings.pools)
        self._users = graph.users()
        self._waiting = {node.id: set(node.needs) for node in graph}
        self._ready = ReadyNodes(graph, self._users, self._settings.order)
        self._suspects: list[NodeId] = []
        self._running: dict[NodeId, Any] = {}  # of distributed.Future
        self._events = EventQueue(listen, self._receive)
        self._attempts: dict[NodeId, int] = {}  # the number of the last one
        self._failures: dict[NodeId, int] = {}
        self._deaths: dict[NodeId, int] = {}
        self._outcome = Outcome()

    def reuse(self, records: Records | None = None) -> Outcome:
        """Marks the nodes that are done already; returns the outcome so far. Needs no cluster.

        A transient node counts as done if all its users are, even if its own result has been removed.

        Args:
            records: says what is done; None: the records, read one by one.
        """
        records = records or self._book
        settled: set[NodeId] = set()
        for node in reversed(list(self._graph)):
            users = self._users[node.id]
            served = node.transient and bool(users) and settled.issuperset(users)
            if served or is_done(records, node):
                settled.add(node.id)
        self._outcome.reused += [node_id for node_id in self._graph.nodes if node_id in settled]
        for node_id in settled:
            del self._waiting[node_id]
        for node_id, needs in self._waiting.items():
            needs -= settled
            if not needs:
                self._ready.push(node_id)
        return self._outcome

    @property
    def remaining(self) -> int:
        """Number of nodes that are neither done nor given up."""
        return len(self._waiting)

    def run(self, client: Client) -> Outcome:
        """Runs the remaining nodes; call `reuse` before.

        Raises:
            ClusterLostError: the scheduler vanished; what is committed stays.
            RunCancelledError: the user cancelled the run.
            LeaseLostError: another driver has taken over.
        """
        from distributed.comm import CommClosedError

        self._client, self._watch = client, SchedulerWatch(client, self._pools)
        self._finished = Completions(client)
        try:
            while self._waiting:
                self._supervisor.check()
                self._skip()
                self._watch.refresh()
                self._fill(self._watch.slots(self._supervisor.hosts.blocked))
                if reason := self._watch.newly_waits(self._ready.stages()):
                    self._events.flush(client, at_once=True)
                    self._listen({"event": "waiting", "time": time.time(), "reason": reason})
                self._events.flush(client)
                self._collect()
            self._events.flush(client, at_once=True)
        except CommClosedError as error:  # it may go while a receipt is on its way
            raise lost("its connection broke") from error
        finally:
            self._events.flush(None, at_once=True)
            for future in self._running.values():
                future.release()
        return self._outcome

    def _fill(self, slots: int) -> None:
        """Keeps one task per worker thread running.

        A node whose worker died runs alone, so that a second death is its own.
        """
        if self._suspects and not self._running:
            if self._supervisor.admit(self._suspects[-1][0].name):
                self._submit(self._suspects.pop())
            return
        while len(self._running) < slots and not self._quarantine():
            node_id = self._ready.pop(self._may_start)
            if node_id is None:
                return
            self._submit(node_id)

    def _may_start(self, stage: str) -> bool:
        """Whether a worker is free for one more task of a stage, and the supervisor admits it."""
        return self._pools.has_room(stage, (i[0].name for i in self._running)) and self._supervisor.admit(stage)

    def _quarantine(self) -> bool:
        return bool(self._suspects) or any(node_id in self._running for node_id in self._deaths)

    def _submit(self, node_id: NodeId) -> None:
        node = self._graph.nodes[node_id]
        number = self._attempts[node_id] = self._attempts.get(node_id, -1) + 1
        # The prefix before the hash groups the dashboard's bars by stage.
        key = (f"{node.stage.name}-{node.key}", node.index, number)
        pool = self._pools.pool_of(node.stage.name)
        workers = self._pools.workers_of(node.stage.name, self._watch.threads)
        future = self._client.submit(
            attempt, self._task, self._context, node.without_needs(), key=key, pure=False, retries=0,
            workers=self._supervisor.hosts.elsewhere(node_id, workers), priority=self._settings.priority,
            resources={pool: 1} if pool else None,
        )  # fmt: skip
        self._running[node_id] = future
        fault_point("driver.after_submit")
        self._tell("start", node, attempt=number)
        self._finished.add(node_id, future)

    def _skip(self) -> None:
        """Gives up the nodes that the user wants to be left out."""
        for command in self._supervisor.take_skips():
            frames, reason = frozenset(command.frames), f"{SKIPPED} by {command.by}"
            nodes = [self._graph.nodes[i] for i in self._waiting if i[0].name == command.stage]
            for node in (node for node in nodes if not frames.isdisjoint(node.frames)):
                if node.id not in self._waiting:
                    continue  # it was blocked by one that was skipped just now
                future = self._running.pop(node.id, None)
                if future is not None:
                    future.release()
                    self._tell("deferred", node, reason=reason)
                if node.id in self._suspects:
                    self._suspects.remove(node.id)
                self._ready.remove(node.id)
                self._outcome.dead[node.id] = reason
                self._tell("skipped", node, reason=reason)
                self._give_up(node.id)

    def _collect(self) -> None:
        """Waits for a task to end and handles all that have ended."""
        for node_id, future in self._finished.take(WAIT_SECONDS):
            self._watch.sign_of_life()
            self._take(node_id, future)

    def _take(self, node_id: NodeId, future: Any) -> None:
        if node_id not in self._running or future is not self._running[node_id]:
            return  # an attempt that is no longer waited for
        node = self._graph.nodes[node_id]
        status = future.status
        if status in ("cancelled", "lost"):
            raise lost("its futures are cancelled")
        del self._running[node_id]
        if status == "finished":
            self._succeed(node)
            self._events.done(node, future)
        else:
            self._fail(node, received(future.exception))

    def _receive(self, node: Node, receipt: Receipt | None) -> Receipt:
        """Counts what a finished task took; its successors were submitted before, so no worker waits for this."""
        receipt = receipt or recorded(self._book, node)
        self._supervisor.hosts.succeeded(receipt.get("worker", ""))
        self._outcome.busy_seconds += receipt["seconds"]
        self._outcome.kernel_seconds += receipt["kernel_seconds"]
        fault_point("driver.after_receipt")
        return receipt

    def _succeed(self, node: Node) -> None:
        """Marks a node as done; nodes that waited only for it become ready."""
        self._outcome.done.append(node.id)
        self._supervisor.shortages.ended(node.stage.name)
        self._waiting.pop(node.id)
        for user in self._users[node.id]:
            if user in self._waiting:
                self._waiting[user].discard(node.id)
                if not self._waiting[user]:
                    self._ready.push(user)

    def _fail(self, node: Node, error: BaseException | None) -> None:
        from distributed import KilledWorker

        if isinstance(error, ShortageError) or (error is not None and is_full(error)):
            self._wait_for_more(node, error)
            return
        self._supervisor.shortages.ended(node.stage.name)
        if isinstance(error, no_worker_errors()):
            if not self._supervisor.hosts.elsewhere(node.id, self._watch.threads):
                raise without_workers() from error
            self._tell("deferred", node, reason="the workers that it was sent to are gone")
            self._ready.push(node.id)
            return
        reason = str(error) if isinstance(error, YesntError) else f"{type(error).__name__}: {error}"
        self._blame(node, worker_of(error), reason)
        if isinstance(error, KilledWorker):
            self._die(node)
        else:
            self._count_failure(node, reason, self._deserves_another(node, error))

    def _wait_for_more(self, node: Node, error: BaseException) -> None:
        """Puts a node back that met a shortage: no failure of its own."""
        what = "the disk is full" if is_full(error) else str(error)
        self._tell("deferred", node, reason=what)
        self._supervisor.shortages.met(node.stage.name, f"frame {node.frames[0]}: {what}")
        self._ready.push(node.id)

    def _deserves_another(self, node: Node, error: BaseException | None) -> bool:
        """Whether a failed node may run once more: not if the input is wrong, which no worker can change."""
        if isinstance(error, MissingPartError):
            return self._supervisor.hosts.untried(node.id, self._watch.threads)
        return not isinstance(error, YesntError) or isinstance(error, LeaseLostError)

    def _count_failure(self, node: Node, reason: str, deserves: bool) -> None:
        self._failures[node.id] = self._failures.get(node.id, 0) + 1
        retry = deserves and self._failures[node.id] <= self._settings.retries
        self._tell("retry" if retry else "failed", node, reason=reason)
        if retry:
            self._ready.push(node.id)
        else:
            self._outcome.failed[node.id] = reason
            self._give_up(node.id)

    def _blame(self, node: Node, worker: str, reason: str) -> None:
        """Notes on which host a node failed; a host that fails one after another gets no more."""
        if worker:
            self._events.flush(self._client, at_once=True)  # what succeeded on the host before counts for it
            blocked = self._supervisor.hosts.failed(node.id, worker, reason, self._watch.threads)
            if blocked:
                self._supervisor.block(blocked)

    def _die(self, node: Node) -> None:
        self._deaths[node.id] = self._deaths.get(node.id, 0) + 1
        dead = self._deaths[node.id] >= self._settings.deaths
        reason = f"its worker died {self._deaths[node.id]} times while this frame was the only task on it"
        self._tell("dead" if dead else "worker_died", node, reason=reason)
        if dead:
            self._outcome.dead[node.id] = reason
            self._give_up(node.id)
        else:
            self._suspects.append(node.id)

    def _give_up(self, node_id: NodeId) -> None:
        """Removes a node and all nodes that need it, directly or not."""
        self._waiting.pop(node_id)
        stack = list(self._users[node_id])
        while stack:
            user = stack.pop()
            if self._waiting.pop(user, None) is not None:
                self._outcome.blocked.append(user)
                stack.extend(self._users[user])

    def _tell(self, event: str, node: Node, **facts: Any) -> None:
        self._events.tell(event, node, **facts)
