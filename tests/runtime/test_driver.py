"""The driver on a real two-worker cluster with tasks that fail and kill on demand."""

from __future__ import annotations

import time
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import pytest
from distributed.comm import CommClosedError

from tests.fake_tasks import A, B, FakeTask, fake_task, runs_of
from tests.runtime.fake_client import FakeClient, without_event_loop
from yesnt.core.errors import ClusterLostError, UsageError
from yesnt.core.shot import GBufferInput, Job, LightInput, PlateInput, Shot
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node
from yesnt.runtime.cluster.open_cluster import open_cluster
from yesnt.runtime.cluster.prepare_workers import prepare_plugin, prepare_workers
from yesnt.runtime.driver import scheduler_watch
from yesnt.runtime.driver.driver import Driver, DriverSettings, Outcome
from yesnt.runtime.launchers.spec import ClusterSpec

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")  # Dask closes sockets of killed workers late


@pytest.fixture(scope="module")
def client():
    with open_cluster(ClusterSpec("local", 2)) as client:
        yield client


@pytest.fixture
def job(tmp_path: Path) -> Job:
    shot = Shot(
        version=1, name="x", frames="0-9", plate=PlateInput(path="p"), gbuffer=GBufferInput(path="g"), camera="c",
        light=LightInput(path="l"),
    )  # fmt: skip
    return Job(shot=shot, root=str(tmp_path), frames=tuple(range(10)), width=1, height=1)


def chain(count: int, **special) -> Graph:
    """`count` frames through stages a -> b; special = {"a3": fields of its FakeTask}."""
    tasks = {name: FakeTask(**fields) for name, fields in special.items()}
    nodes = [Node(A, i, (i,), {"a": i}, (), tasks.get(f"a{i}", FakeTask())) for i in range(count)]
    nodes += [Node(B, i, (i,), {"b": i}, ((A, i),), tasks.get(f"b{i}", FakeTask())) for i in range(count)]
    return Graph(nodes)


def drive(job: Job, graph: Graph, client, events: list | None = None, **settings) -> Outcome:
    book = RecordBook(Path(job.root) / "records")
    listen = events.append if events is not None else lambda event: None
    driver = Driver(job, graph, book, fake_task, DriverSettings(**settings), listen)
    driver.reuse()
    return driver.run(client)


def test_everything_runs_once_and_is_reused(job: Job, client) -> None:
    outcome = drive(job, chain(6), client)
    assert outcome.complete
    assert len(outcome.done) == 12
    again = drive(job, chain(6), client)
    assert (len(again.done), len(again.reused)) == (0, 12)
    assert all(runs_of(job, s, i) == 1 for s in "ab" for i in range(6))


def test_needs_come_first_and_begun_frames_are_finished_early(job: Job, client) -> None:
    events: list = []
    drive(job, chain(8), client, events)
    finished = [(e["stage"], e["frames"][0]) for e in events if e["event"] == "done"]
    assert all(finished.index(("a", i)) < finished.index(("b", i)) for i in range(8))
    assert finished.index(("b", 0)) < finished.index(("a", 7)), "later stages drain what is begun"


def test_at_most_one_task_a_slot_is_under_way(job: Job, client) -> None:
    events: list = []
    drive(job, chain(8), client, events)
    running = most = 0
    for event in events:
        running += {"start": 1, "done": -1}.get(event["event"], 0)
        most = max(most, running)
    assert most == 2


def test_a_task_that_fails_once_is_tried_again(job: Job, client) -> None:
    outcome = drive(job, chain(3, a1={"fail": 1}), client)
    assert outcome.complete
    assert runs_of(job, "a", 1) == 2


def test_a_task_that_always_fails_is_named_and_the_others_finish(job: Job, client) -> None:
    outcome = drive(job, chain(4, a1={"fail": 99}), client)
    assert set(outcome.failed) == {(A, 1)}
    assert "RuntimeError: told to fail" in outcome.failed[A, 1]
    assert outcome.blocked == [(B, 1)]
    assert len(outcome.done) == 6
    assert runs_of(job, "a", 1) == 2


def test_a_frame_that_kills_its_worker_twice_is_dead_and_only_it(job: Job, client) -> None:
    events: list = []
    outcome = drive(job, chain(6, a2={"kill": True}), client, events)
    assert set(outcome.dead) == {(A, 2)}
    assert outcome.blocked == [(B, 2)]
    assert len(outcome.done) == 10
    assert not outcome.failed
    assert runs_of(job, "a", 2) == 2
    assert [e["event"] for e in events if e["frames"] == [2] and e["event"] in ("worker_died", "dead")] == [
        "worker_died",
        "dead",
    ]


def test_two_poison_frames_do_not_take_each_other_or_innocents_along(job: Job, client) -> None:
    outcome = drive(job, chain(6, a1={"kill": True}, a2={"kill": True}, a3={"sleep": 0.5}), client)
    assert set(outcome.dead) == {(A, 1), (A, 2)}
    assert len(outcome.done) == 8


def test_dashboard_groups_by_stage(job: Job, client, monkeypatch) -> None:
    """The dashboard colours and sums tasks by the prefix of their keys (`key_split`): it must be the stage."""
    from dask.utils import key_split

    keys, submit = [], client.submit

    def recorded(*arguments, key, **options):
        keys.append(key)
        return submit(*arguments, key=key, **options)

    monkeypatch.setattr(client, "submit", recorded)
    drive(job, chain(3), client)
    assert sorted(key_split(key) for key in keys) == ["a", "a", "a", "b", "b", "b"]
    assert len(set(keys)) == 6


def test_cluster_listens_on_loopback_only_with_one_thread_each(client) -> None:
    assert client.scheduler.address.startswith("tcp://127.0.0.1:")
    assert "//127.0.0.1:" in client.dashboard_link
    assert set(client.nthreads().values()) == {1}
    assert all(set(counts.values()) <= {0, 1} for counts in client.run(_thread_counts).values())


def _thread_counts() -> dict[str, int]:
    import numba  # noqa: F401
    import torch  # noqa: F401

    from yesnt.core.threads import pin_threads

    return pin_threads()


def test_remote_schedulers_need_tls() -> None:
    with pytest.raises(UsageError, match="must use TLS"), open_cluster(ClusterSpec("tcp://10.0.0.1:8786")):
        pass
    with pytest.raises(UsageError, match="No cluster of the kind"), open_cluster(ClusterSpec("cloud")):
        pass


def test_a_scheduler_that_is_not_there_is_a_lost_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("yesnt.runtime.cluster.open_cluster.CONNECT_SECONDS", 1)
    with pytest.raises(ClusterLostError, match="does not answer"), open_cluster(ClusterSpec("tcp://127.0.0.1:9")):
        pass


def test_an_outcome_is_complete_if_nothing_failed_died_or_was_blocked() -> None:
    assert Outcome(done=[(A, 0)], reused=[(B, 0)]).complete
    assert not Outcome(failed={(A, 0): "why"}).complete
    assert not Outcome(dead={(A, 0): "why"}).complete
    assert not Outcome(blocked=[(A, 0)]).complete


def test_graph_refuses_nodes_before_their_needs() -> None:
    with pytest.raises(ValueError, match="before what it needs"):
        Graph([Node(B, 0, (0,), {}, ((A, 0),))])


def test_closure_keeps_only_what_targets_need() -> None:
    assert set(chain(4).closure([(B, 2)]).nodes) == {(A, 2), (B, 2)}


@pytest.fixture
def _without_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Futures of this file's clients need no event loop."""
    without_event_loop(monkeypatch)


class _LostFuture:
    """A task that ended, whose result can no longer be fetched."""

    status = "finished"

    def exception(self, timeout: float) -> Exception:
        return self._error

    def __init__(self, error: Exception) -> None:
        self._error = error

    def result(self, timeout: float) -> None:
        raise self._error

    def release(self) -> None:
        pass


def client_whose_receipts(raise_or_return, monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    """Runs tasks here; their receipts cannot be fetched."""
    client = FakeClient(monkeypatch, workers=("tcp://127.0.0.1:1",))

    def sync(call, callback_timeout: float):
        return raise_or_return()

    monkeypatch.setattr(client, "sync", sync)
    return client


def raising(error: Exception):
    def fails():
        raise error

    return fails


def test_a_scheduler_lost_while_it_hands_receipts_over_is_a_lost_cluster(job: Job, monkeypatch) -> None:
    events: list = []
    with pytest.raises(ClusterLostError, match="run the same command again"):
        drive(job, chain(1), client_whose_receipts(raising(CommClosedError("reset by peer")), monkeypatch), events)
    assert [e["event"] for e in events][:2] == ["start", "done"], "what was done is told all the same"


@pytest.mark.usefixtures("_without_event_loop")
def test_a_scheduler_lost_while_it_hands_an_error_over_is_a_lost_cluster(job: Job) -> None:
    class Unreachable(_LostFuture):
        status = "error"

        def exception(self, timeout: float) -> Exception:
            raise TimeoutError

    client = SimpleNamespace(
        submit=lambda *args, **options: Unreachable(TimeoutError()),
        workers={"worker": 1},
    )
    with pytest.raises(ClusterLostError, match="run the same command again"):
        drive(job, chain(1), client)


@pytest.mark.parametrize("answer", [raising(TimeoutError()), lambda: {0: None}, dict])
def test_receipts_that_died_with_their_worker_lose_no_work(job: Job, monkeypatch, answer) -> None:
    events: list = []
    outcome = drive(job, chain(2), client_whose_receipts(answer, monkeypatch), events)
    assert outcome.complete
    assert [e["event"] for e in events].count("done") == len(outcome.done) == 4
    assert all(runs_of(job, s, i) == 1 for s in "ab" for i in range(2))


class _LeavingWorkers:
    """A client whose workers leave while they are prepared, so many times."""

    cluster = None
    status = "running"
    scheduler = SimpleNamespace(address="tcp://127.0.0.1:8786")

    def __init__(self, times: int, error: Exception) -> None:
        self.left, self._error = times, error
        self.asked: list[bool] = []

    def register_plugin(self, plugin) -> None:
        self.asked.append(plugin.idempotent)
        if self.left:
            self.left -= 1
            raise self._error


@pytest.mark.parametrize("error", [CommClosedError("closed"), RuntimeError("cannot schedule new futures")])
def test_a_worker_that_leaves_while_a_run_attaches_is_passed_over(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    monkeypatch.setattr("yesnt.runtime.cluster.prepare_workers.time.sleep", lambda seconds: None)
    client = _LeavingWorkers(2, error)
    prepare_workers(client, prepare_plugin((), compiles=False))
    assert client.asked == [True, False, False], "workers that were passed over are asked again"


def test_workers_that_never_stay_are_a_lost_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    monkeypatch.setattr("yesnt.runtime.cluster.prepare_workers.time.sleep", pauses.append)
    with pytest.raises(ClusterLostError, match=r"cannot be prepared \(CommClosedError: closed\).*:8786.*run the same"):
        prepare_workers(_LeavingWorkers(100, CommClosedError("closed")), prepare_plugin((), compiles=False))
    assert sum(pauses) < 20
    gone = _LeavingWorkers(100, CommClosedError("closed"))
    gone.status = "closed"
    with pytest.raises(ClusterLostError):
        prepare_workers(gone, prepare_plugin((), compiles=False))
    assert len(gone.asked) == 1, "a scheduler that is gone is not asked again"


def answering_once(workers: dict[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """A scheduler that says which workers there are, and answers no second time."""
    first: Future[dict[str, int]] = Future()
    first.set_result(workers)
    answers = iter([first])
    monkeypatch.setattr(scheduler_watch, "ask", lambda client: next(answers, Future()))
    monkeypatch.setattr(scheduler_watch, "HEARTBEAT_SECONDS", 0.0)
    monkeypatch.setattr(scheduler_watch, "LOSS_SECONDS", 0.3)


def test_a_scheduler_too_busy_to_answer_is_not_lost_while_tasks_end(job: Job, monkeypatch) -> None:
    client = FakeClient(monkeypatch, before=lambda node, worker: time.sleep(0.1), workers=("tcp://127.0.0.1:1",))
    answering_once(client.workers, monkeypatch)
    began = time.monotonic()
    assert drive(job, chain(4), client).complete
    assert time.monotonic() - began > 2 * scheduler_watch.LOSS_SECONDS


@pytest.mark.usefixtures("_without_event_loop")
def test_a_scheduler_that_neither_answers_nor_tells_of_ends_is_lost(job: Job, monkeypatch) -> None:
    class Silent(_LostFuture):
        status = "pending"

    answering_once({"tcp://127.0.0.1:1": 1}, monkeypatch)
    client = SimpleNamespace(submit=lambda *args, **options: Silent(RuntimeError()), sync=lambda *args, **options: {})
    began = time.monotonic()
    with pytest.raises(ClusterLostError, match=r"it does not answer.*run the same command again"):
        drive(job, chain(1), client)
    assert time.monotonic() - began < 5


@pytest.mark.usefixtures("_without_event_loop")
def test_a_run_waits_for_the_next_worker_and_says_so(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("yesnt.runtime.driver.scheduler_watch.HEARTBEAT_SECONDS", 0.0)
    monkeypatch.setattr("yesnt.runtime.driver.scheduler_watch.ALONE_SECONDS", 0.2)
    workers: dict[str, int] = {}

    class Late(_LostFuture):
        status = "pending"

        def result(self, timeout: float) -> dict:
            return {"seconds": 0.0, "kernel_seconds": 0.0}

    def listen(event) -> None:
        events.append(event)
        if event["event"] == "waiting":
            workers["tcp://127.0.0.1:1"] = 1
            futures[0].status = "finished"

    futures: list[Late] = []
    events: list = []

    def submit(attempt, task, context, node, **options) -> Late:
        futures.append(Late(RuntimeError()))
        return futures[-1]

    client = SimpleNamespace(submit=submit, workers=workers, sync=lambda call, callback_timeout: {})
    graph = Graph([Node(A, 0, (0,), {"a": 0})])
    driver = Driver(job, graph, RecordBook(Path(job.root) / "records"), fake_task, listen=listen)
    driver.reuse()
    assert driver.run(client).complete
    assert [e["event"] for e in events] == ["start", "waiting", "done"]


@pytest.mark.usefixtures("_without_event_loop")
def test_a_scheduler_without_workers_for_too_long_is_a_lost_cluster(job: Job) -> None:
    from distributed.scheduler import NoWorkerError

    class Unrunnable(_LostFuture):
        status = "error"

    client = SimpleNamespace(
        submit=lambda *args, **options: Unrunnable(NoWorkerError("a", 120)),
        workers={},
    )
    with pytest.raises(ClusterLostError, match=r"No worker has joined.*start workers"):
        drive(job, chain(1), client)
