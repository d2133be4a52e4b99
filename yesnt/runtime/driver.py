"""Runs a graph of tasks on a Dask cluster: order, retries, dead workers, resume.

The driver submits only as many tasks as the cluster has worker threads. Completed work is read from the commit records
alone, so a driver, a worker or a scheduler may vanish at any moment, and the next run continues from the records.
"""

from __future__ import annotations

import heapq
import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import ClusterLostError, YesntError
from yesnt.core.fault_points import fault_point
from yesnt.io.durable import disk_full, is_full
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node, NodeId

if TYPE_CHECKING:
    from distributed import Client

Receipt = dict[str, Any]
Task = Callable[[Any, Node], Receipt]
Listener = Callable[[Mapping[str, Any]], None]
Place = tuple[int, int, int]

HEARTBEAT_SECONDS = 2.0
LOSS_SECONDS = 8.0
"""A scheduler that has not answered for this long is lost."""

ALONE_SECONDS = 4.0
"""A scheduler without workers for this long is reported to the user."""

NO_WORKER = "the scheduler has no worker; the run goes on when one joins"


@dataclass(frozen=True)
class DriverSettings:
    """How failures are handled.

    Attributes:
        retries: how often a task that raised an exception is run again.
        deaths: a node is dead after its worker died this often while the node was the only task on it.
    """

    retries: int = 1
    deaths: int = 2


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


def is_done(book: RecordBook, node: Node) -> bool:
    """Whether every frame of a node has a record that holds its key."""
    return all(book.done(node.stage, frame, node.frame_key(frame)) for frame in node.frames)


class Driver:
    """Runs the nodes of a graph that have no record yet.

    Args:
        context: sent with every task, such as the job; small.
        graph: nodes, each after those that it needs.
        book: the commit records.
        task: importable function that runs a node on a worker.
        settings: retries and deaths.
        listen: called with a small dictionary for every event: start, done, retry, failed, worker_died, dead, waiting.
    """

    def __init__(
        self,
        context: Any,
        graph: Graph,
        book: RecordBook,
        task: Task,
        settings: DriverSettings | None = None,
        listen: Listener = lambda event: None,
    ) -> None:
        self._context, self._graph, self._book, self._task = context, graph, book, task
        self._settings, self._listen = settings or DriverSettings(), listen
        self._place = _places(graph)
        self._users = graph.users()
        self._waiting = {node.id: set(node.needs) for node in graph}
        self._ready: list[tuple[Place, NodeId]] = []
        self._suspects: list[NodeId] = []
        self._running: dict[NodeId, Any] = {}  # of distributed.Future
        self._finished: queue.SimpleQueue[tuple[NodeId, Any]] = queue.SimpleQueue()
        self._unread: list[tuple[Node, Any]] = []  # finished, and their users are on their way; receipts not fetched
        self._failures: dict[NodeId, int] = {}
        self._deaths: dict[NodeId, int] = {}
        self._outcome = Outcome()

    def reuse(self) -> Outcome:
        """Marks the nodes that are done already; returns the outcome so far. Needs no cluster.

        A transient node counts as done if all its users are, even if its own result has been removed.
        """
        settled: set[NodeId] = set()
        for node in reversed(list(self._graph)):
            users = self._users[node.id]
            served = node.transient and bool(users) and settled.issuperset(users)
            if served or is_done(self._book, node):
                settled.add(node.id)
        self._outcome.reused += [node_id for node_id in self._graph.nodes if node_id in settled]
        for node_id in settled:
            del self._waiting[node_id]
        for node_id, needs in self._waiting.items():
            needs -= settled
            if not needs:
                self._push(node_id)
        return self._outcome

    @property
    def remaining(self) -> int:
        """Number of nodes that are neither done nor given up."""
        return len(self._waiting)

    def run(self, client: Client) -> Outcome:
        """Runs the remaining nodes; call `reuse` before.

        Raises:
            ClusterLostError: the scheduler vanished; what is committed stays.
            YesntError: the disk is full.
        """
        from distributed.comm import CommClosedError

        heartbeat = _Heartbeat(client)
        try:
            while self._waiting or self._unread:
                started = self._fill(client, heartbeat.slots())
                if heartbeat.newly_alone():
                    self._listen({"event": "waiting", "time": time.time(), "reason": NO_WORKER})
                self._read_receipts()
                for node, attempt in started:
                    self._tell("start", node, attempt=attempt)
                if self._running:
                    self._collect()
        except CommClosedError as error:  # it may go while a receipt is on its way
            raise _lost("its connection broke") from error
        finally:
            for future in self._running.values():
                future.release()
        return self._outcome

    def _fill(self, client: Client, slots: int) -> list[tuple[Node, int]]:
        """Keeps one task per worker thread running.

        A node whose worker died runs alone, so that a second death is its own.

        Returns:
            what it started, each with the number of the attempt.
        """
        if self._suspects and not self._running:
            return [self._submit(client, self._suspects.pop())]
        started = []
        while self._ready and len(self._running) < slots and not self._quarantine():
            started.append(self._submit(client, heapq.heappop(self._ready)[1]))
        return started

    def _quarantine(self) -> bool:
        return bool(self._suspects) or any(self._deaths.get(node_id) for node_id in self._running)

    def _submit(self, client: Client, node_id: NodeId) -> tuple[Node, int]:
        node = self._graph.nodes[node_id]
        attempt = self._failures.get(node_id, 0) + self._deaths.get(node_id, 0)
        # The prefix before the hash groups the dashboard's bars by stage.
        key = (f"{node.stage.name}-{node.key}", node.index, attempt)
        sent = node.without_needs()
        future = client.submit(self._task, self._context, sent, key=key, pure=False, retries=0)
        self._running[node_id] = future
        fault_point("driver.after_submit")
        future.add_done_callback(lambda done, node_id=node_id: self._finished.put((node_id, done)))
        return node, attempt

    def _collect(self) -> None:
        """Waits for a task to end and handles all that have ended."""
        try:
            self._take(*self._finished.get(timeout=0.5))
            while True:
                self._take(*self._finished.get_nowait())
        except queue.Empty:
            return

    def _take(self, node_id: NodeId, future: Any) -> None:
        if node_id not in self._running or future is not self._running[node_id]:
            return  # an attempt that is no longer waited for
        node = self._graph.nodes[node_id]
        status = future.status
        if status in ("cancelled", "lost"):
            raise _lost("its futures are cancelled")
        del self._running[node_id]
        if status == "finished":
            self._succeed(node)
            self._unread.append((node, future))
        else:
            self._fail(node, _received(future.exception))

    def _read_receipts(self) -> None:
        """Fetches the receipts of finished tasks; their successors were submitted before, so no worker waits for it."""
        from distributed import KilledWorker

        while self._unread:
            node, future = self._unread.pop(0)
            try:
                receipt: Receipt = _received(future.result)
            except KilledWorker:  # the worker died with it, and the next one while Dask had it made again
                receipt = self._recorded(node)
            self._outcome.busy_seconds += receipt["seconds"]
            self._outcome.kernel_seconds += receipt["kernel_seconds"]
            self._tell("done", node, **receipt)
            fault_point("driver.after_receipt")

    def _recorded(self, node: Node) -> Receipt:
        """A receipt made from the commit record, for a task whose worker died after it had committed."""
        record = self._book.find(node.stage, node.frames[-1])
        seconds, facts = ({}, {}) if record is None else (record.seconds, record.facts)
        return {
            "seconds": seconds.get("task", 0.0),
            "kernel_seconds": seconds.get("kernel", 0.0),
            "peak_bytes": facts.get("peak_bytes", 0),
        }

    def _succeed(self, node: Node) -> None:
        """Marks a node as done; nodes that waited only for it become ready."""
        self._outcome.done.append(node.id)
        self._waiting.pop(node.id)
        for user in self._users[node.id]:
            if user in self._waiting:
                self._waiting[user].discard(node.id)
                if not self._waiting[user]:
                    self._push(user)

    def _fail(self, node: Node, error: BaseException | None) -> None:
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):
            self._die(node)
            return
        if isinstance(error, _no_worker_errors()):
            raise ClusterLostError(
                "No worker has joined the scheduler for too long", "the Dask scheduler", "at least one worker",
                "start workers, then run the same command again: it resumes from what is committed",
            ) from error  # fmt: skip
        if error is not None and is_full(error):
            raise disk_full(error, f"stage {node.stage}, frame {node.frames[0]}") from error
        self._failures[node.id] = self._failures.get(node.id, 0) + 1
        reason = f"{type(error).__name__}: {error}" if not isinstance(error, YesntError) else str(error)
        retry = not isinstance(error, YesntError) and self._failures[node.id] <= self._settings.retries
        self._tell("retry" if retry else "failed", node, reason=reason)
        if retry:
            self._push(node.id)
        else:
            self._outcome.failed[node.id] = reason
            self._give_up(node.id)

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

    def _push(self, node_id: NodeId) -> None:
        heapq.heappush(self._ready, (self._place[node_id], node_id))

    def _tell(self, event: str, node: Node, **facts: Any) -> None:
        self._listen(
            {"event": event, "time": time.time(), "stage": node.stage.label, "frames": list(node.frames), **facts}
        )


def _places(graph: Graph) -> dict[NodeId, Place]:
    """Priority of each node among those that are ready: late stages first, to finish frames early; then by frame.

    Stages of equal depth (flow and decomposition) alternate frame by frame, so that a worker reads each plate once.
    """
    depth: dict[NodeId, int] = {}
    for node in graph:
        depth[node.id] = 1 + max((depth[need] for need in node.needs), default=0)
    return {node.id: (-depth[node.id], node.frames[0], i) for i, node in enumerate(graph)}


class _Heartbeat:
    """Asks the scheduler every few seconds how many slots there are; notices when it no longer answers."""

    def __init__(self, client: Client) -> None:
        self._client, self._slots, self._asked, self._answered = client, 1, 0.0, time.monotonic()
        self._alone_since: float | None = None
        self._alone_told = False

    def slots(self) -> int:
        """Threads of all workers, at least 1: a task is handed over even if its worker is still to join.

        Raises:
            ClusterLostError: the scheduler does not answer.
        """
        now = time.monotonic()
        if now - self._asked >= HEARTBEAT_SECONDS:
            self._asked = now
            try:
                threads = self._client.sync(self._client.scheduler.ncores, callback_timeout=LOSS_SECONDS / 2)
            except (OSError, TimeoutError, RuntimeError, ValueError, AttributeError):
                if now - self._answered > LOSS_SECONDS / 2:
                    raise _lost("it does not answer") from None
            else:
                self._answered = time.monotonic()
                self._count(sum(threads.values()))
        return self._slots

    def newly_alone(self) -> bool:
        """Whether there has been no worker for a while; True once each time that happens."""
        alone = self._alone_since is not None and time.monotonic() - self._alone_since >= ALONE_SECONDS
        newly, self._alone_told = alone and not self._alone_told, alone
        return newly

    def _count(self, threads: int) -> None:
        self._slots = max(1, threads)
        if threads:
            self._alone_since = None
        elif self._alone_since is None:
            self._alone_since = self._answered


def _no_worker_errors() -> tuple[type[Exception], ...]:
    from distributed.scheduler import NoValidWorkerError, NoWorkerError

    return NoValidWorkerError, NoWorkerError


def _received(fetch: Callable[..., Any]) -> Any:
    """Fetches the result or the exception of a task that has ended; a lost scheduler raises ClusterLostError."""
    from distributed.client import FutureCancelledError

    try:
        return fetch(timeout=LOSS_SECONDS)
    except FutureCancelledError as error:
        raise _lost("its futures are cancelled") from error
    except TimeoutError as error:
        raise _lost("it does not hand a result over") from error


def _lost(why: str) -> ClusterLostError:
    return ClusterLostError(
        f"The scheduler is lost ({why})", "the Dask scheduler", "a scheduler that answers",
        "run the same command again: it resumes from what is committed",
    )  # fmt: skip
