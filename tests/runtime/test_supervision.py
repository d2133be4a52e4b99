"""Pauses, skips, cancellation, shortages and failing hosts: what stops tasks from starting, and how it ends."""

from __future__ import annotations

import errno
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.fake_tasks import A, B, FakeTask, fake_task, runs_of
from tests.runtime.fake_client import WORKERS, FakeClient, short_of
from yesnt.core.errors import LeaseLostError, MissingPartError, RunCancelledError
from yesnt.io.commands import Command, own_name, send_command, take_commands
from yesnt.io.lease import Lease
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node
from yesnt.runtime.driver import event_queue
from yesnt.runtime.driver import supervisor as supervisor_module
from yesnt.runtime.driver.driver import Driver, DriverSettings, Outcome
from yesnt.runtime.driver.event_queue import EventQueue
from yesnt.runtime.driver.host_failures import HostFailures
from yesnt.runtime.driver.packed import Packed
from yesnt.runtime.driver.shortages import Shortages
from yesnt.runtime.driver.supervisor import Supervisor, Watched

RUN, BY = "run-1", "ann@here"


@pytest.fixture(autouse=True)
def _always_looking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "CHECK_SECONDS", 0.0)
    monkeypatch.setattr(event_queue, "FLUSH_SECONDS", 0.0)


def chain(count: int) -> Graph:
    """`count` frames through stages a -> b, frame i numbered 10 + i."""
    nodes = [Node(A, i, (10 + i,), {"a": i}, (), FakeTask(sleep=0)) for i in range(count)]
    nodes += [Node(B, i, (10 + i,), {"b": i}, ((A, i),), FakeTask(sleep=0)) for i in range(count)]
    return Graph(nodes)


class Bench:
    """A driver with everything around it, in one folder."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.job, self._patch = SimpleNamespace(root=str(folder)), monkeypatch
        self.commands, self.events = folder / "control", list[dict]()
        self.lease: Lease | None = None
        self.room = 0
        self.on_event: Callable[[dict], None] = lambda event: None

    def send(self, verb: str, **more) -> None:
        send_command(self.commands, Command(verb, more.pop("run", RUN), BY, **more))

    def listen(self, event) -> None:
        self.events.append(dict(event))
        self.on_event(event)

    def drive(self, graph: Graph, client: FakeClient | None = None, **settings) -> Outcome:
        book = RecordBook(Path(self.job.root) / "records")
        watched = Watched((RUN,), self.commands, self.lease, Path(self.job.root), self.room)
        watch = Supervisor(watched, self.listen)
        watch.shortages = Shortages(self.listen, 0.01)
        self.supervisor = watch
        driver = Driver(self.job, graph, book, fake_task, DriverSettings(**settings), self.listen, watch)
        driver.reuse()
        return driver.run(client or FakeClient(self._patch))

    def names(self, *kinds: str) -> list[str]:
        return [event["event"] for event in self.events if event["event"] in kinds]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(tmp_path, monkeypatch)


def test_commands_are_taken_once_in_the_order_they_were_sent(tmp_path: Path) -> None:
    sent = [Command("pause", RUN, BY), Command("skip", RUN, own_name(), "relight", (1, 2)), Command("resume", RUN, BY)]
    for command in sent:
        send_command(tmp_path, command)
    (tmp_path / "000009.json").write_text("{")
    assert list(take_commands(tmp_path)) == sent
    assert not list(tmp_path.iterdir())


def test_a_paused_run_starts_nothing_until_it_is_resumed(bench: Bench) -> None:
    bench.send("pause")
    started: list[int] = []

    def on_event(event: dict) -> None:
        if event["event"] == "paused":
            started.append(bench.names("start").count("start"))
            bench.send("resume")

    bench.on_event = on_event
    assert bench.drive(chain(3)).complete
    assert started == [0]
    assert bench.names("paused", "resumed") == ["paused", "resumed"]
    assert {event["by"] for event in bench.events if event["event"] == "paused"} == {BY}


def test_a_cancelled_run_ends_and_the_next_one_goes_on(bench: Bench) -> None:
    bench.on_event = lambda event: bench.send("cancel") if bench.names("done") == ["done"] else None
    with pytest.raises(RunCancelledError, match=f"cancelled by {BY}.*goes on from what is committed"):
        bench.drive(chain(5))
    done = len(list((Path(bench.job.root) / "records").glob("*/*.json")))
    assert 0 < done < 10
    bench.on_event = lambda event: None
    assert bench.drive(chain(5)).complete
    assert all(runs_of(bench.job, stage, i) == 1 for stage in "ab" for i in range(5))


def test_a_command_for_an_earlier_run_changes_nothing(bench: Bench) -> None:
    bench.send("cancel", run="run-0")
    assert bench.drive(chain(2)).complete
    assert not list(bench.commands.iterdir())


def test_skipped_frames_are_left_out_and_all_others_finish(bench: Bench) -> None:
    bench.send("skip", stage="a", frames=(11, 12))
    outcome = bench.drive(chain(4))
    assert outcome.dead == {(A, 1): f"skipped by {BY}", (A, 2): f"skipped by {BY}"}
    assert set(outcome.blocked) == {(B, 1), (B, 2)}
    assert set(outcome.done) == {(A, 0), (A, 3), (B, 0), (B, 3)}
    assert runs_of(bench.job, "a", 1) == 0


def test_a_driver_that_lost_its_lease_starts_nothing_more(bench: Bench, tmp_path: Path) -> None:
    bench.lease = Lease(tmp_path / "leases", "driver")
    (tmp_path / "leases").mkdir()
    assert bench.lease.claim(None)
    (tmp_path / "leases" / "driver.1").unlink()
    with pytest.raises(LeaseLostError):
        bench.drive(chain(2))
    assert not bench.names("start")


def test_a_shortage_pauses_its_stage_alone_and_fails_no_frame(bench: Bench) -> None:
    lacking = short_of("licence", 3)
    client = FakeClient(bench._patch, lambda node, worker: lacking(node, worker) if node.stage == B else None)
    outcome = bench.drive(chain(4), client, retries=0)
    assert outcome.complete
    assert bench.names("failed", "retry", "shortage", "shortage_over") == ["shortage", "shortage_over"]
    (shortage,) = [event for event in bench.events if event["event"] == "shortage"]
    assert (shortage["stage"], shortage["reason"]) == ("b", "frame 10: No licence is free.")


def test_a_full_disk_is_a_shortage(bench: Bench) -> None:
    left = [2]

    def full(node, worker: str) -> None:
        if left[0]:
            left[0] -= 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/out/x")

    assert bench.drive(chain(3), FakeClient(bench._patch, full), retries=0).complete
    assert bench.names("failed", "retry", "shortage", "shortage_over") == ["shortage", "shortage_over"]
    assert "the disk is full" in next(e["reason"] for e in bench.events if e["event"] == "shortage")


def test_a_disk_that_is_nearly_full_pauses_the_run(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    free = [10]
    monkeypatch.setattr(supervisor_module.shutil, "disk_usage", lambda path: SimpleNamespace(free=free[0]))
    bench.room = 1000

    def on_event(event: dict) -> None:
        if event["event"] == "shortage":
            assert not bench.names("start")
            free[0] = 10_000

    bench.on_event = on_event
    assert bench.drive(chain(2)).complete
    assert bench.names("shortage", "shortage_over") == ["shortage", "shortage_over"]


def test_pauses_between_attempts_grow_and_a_task_that_gave_something_back_ends_them(monkeypatch) -> None:
    now, told = [0.0], []
    monkeypatch.setattr(
        "yesnt.runtime.driver.shortages.time", SimpleNamespace(monotonic=lambda: now[0], time=lambda: 0)
    )
    found = Shortages(told.append)
    found.met("a", "no licence")
    waits = []
    for _ in range(6):
        began = now[0]
        while not found.admit("a"):
            now[0] += 1
        assert not found.admit("a"), "one attempt at a time"
        waits.append(now[0] - began)
        found.met("a", "no licence")
    assert waits == [5, 10, 20, 40, 60, 60]
    assert found.admit("b")
    found.ended("a")
    assert found.admit("a"), "another task ended: it may have given the licence back"
    found.ended("a")
    assert [event["event"] for event in told] == ["shortage", "shortage_over"]
    now[0] = 2000


def test_a_shortage_that_lasts_is_told_again(monkeypatch) -> None:
    now, told = [0.0], []
    monkeypatch.setattr(
        "yesnt.runtime.driver.shortages.time", SimpleNamespace(monotonic=lambda: now[0], time=lambda: 0)
    )
    found = Shortages(told.append)
    for now[0] in (0.0, 100.0, 601.0, 700.0):
        found.met("a", "no licence")
    assert len(told) == 2


def test_a_host_that_fails_everything_is_blocked_and_loses_no_frame(bench: Bench) -> None:
    bad = WORKERS[1]

    def before(node, worker: str) -> None:
        if worker == bad:
            raise OSError("no such mount")

    client = FakeClient(bench._patch, before)
    outcome = bench.drive(chain(20), client)
    assert outcome.complete
    assert len([one for one in client.ran if one[2] == bad]) == 3
    (event,) = [event for event in bench.events if event["event"] == "host_blocked"]
    assert event["host"] == "10.0.0.2"
    assert event["reason"].startswith("3 different frames in a row failed on it, the last with: OSError: no such mount")


def test_the_last_host_is_never_blocked_and_frames_that_fail_everywhere_fail(bench: Bench) -> None:
    def before(node, worker: str) -> None:
        raise RuntimeError("broken")

    outcome = bench.drive(chain(5), FakeClient(bench._patch, before))
    assert len(outcome.failed) == 5
    assert len(bench.supervisor.hosts.blocked) == 2


def test_a_part_that_one_host_lacks_is_tried_on_another(bench: Bench) -> None:
    def before(node, worker: str) -> None:
        if worker == WORKERS[0]:
            raise MissingPartError("diffusers is not installed")

    assert bench.drive(chain(8), FakeClient(bench._patch, before)).complete


def test_failures_with_successes_between_block_no_host() -> None:
    hosts = HostFailures()
    for i in range(9):
        assert hosts.failed((A, i), WORKERS[0], "why", WORKERS) == ""
        if i % 2:
            hosts.succeeded(WORKERS[0])
    assert hosts.elsewhere((A, 99), WORKERS) is None
    assert hosts.elsewhere((A, 8), WORKERS) == list(WORKERS[1:])
    assert not HostFailures().failed((A, 0), WORKERS[0], "why", WORKERS[:1])


@pytest.mark.parametrize(
    ("order", "first"), [((), [10, 11, 12]), ((14, 10, 12), [14, 10, 12]), ((19, 18), [19, 18, 10])]
)
def test_frames_are_finished_in_the_order_they_are_wanted(
    bench: Bench, order: tuple[int, ...], first: list[int]
) -> None:
    bench.drive(chain(10), FakeClient(bench._patch, workers=WORKERS[:1]), order=order)
    assert [e["frames"][0] for e in bench.events if e["event"] == "done" and e["stage"] == "b"][:3] == first


def test_a_job_is_packed_small_and_unpacked_once() -> None:
    job = {"frames": tuple(range(1001, 11001))}
    packed = Packed.of(job)
    assert packed.unpack() == job
    assert Packed(bytes(packed.data)).unpack() is packed.unpack()
    assert len(pickle.dumps(packed)) < len(pickle.dumps(job)) / 5


def test_events_are_told_in_their_order_with_the_receipts_of_one_request(monkeypatch: pytest.MonkeyPatch) -> None:
    told, asked = [], []
    queue = EventQueue(told.append, lambda node, receipt: receipt or {"seconds": -1})
    nodes = [Node(A, i, (i,), {"a": i}) for i in range(3)]
    queue.tell("start", nodes[0])
    queue.done(nodes[0], "future 0")
    queue.done(nodes[1], "future 1")
    queue.tell("start", nodes[2])
    client = SimpleNamespace(sync=lambda call, callback_timeout: asked.append(call) or {1: {"seconds": 5}, 2: None})
    monkeypatch.setattr(event_queue, "FLUSH_SECONDS", 60.0)
    queue.flush(client)
    assert not told
    queue.flush(client, at_once=True)
    assert [(e["event"], e["frames"], e.get("seconds")) for e in told] == [
        ("start", [0], None), ("done", [0], 5), ("done", [1], -1), ("start", [2], None),
    ]  # fmt: skip
    assert len(asked) == 1
    queue.flush(client, at_once=True)
    assert len(told) == 4
