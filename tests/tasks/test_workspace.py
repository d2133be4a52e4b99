"""A task's clock, and frames that it commits by a link to another stage's."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import LeaseLostError
from yesnt.core.stage_id import StageId
from yesnt.io.lease import take_lease
from yesnt.io.output import OutputFolder
from yesnt.io.store import FrameStore
from yesnt.planning.graph import Node
from yesnt.planning.stages import DECOMPOSE
from yesnt.runtime.checks.preflight import resolve
from yesnt.runtime.session import Session
from yesnt.tasks.clock import Clock
from yesnt.tasks.run import run_node
from yesnt.tasks.workspace import Workspace


def spend(seconds: float) -> None:
    time.sleep(seconds)


def test_reading_inside_a_kernel_is_not_kernel_time() -> None:
    clock = Clock()
    with clock.reading_time():
        spend(0.02)  # before the kernel: no part of it
    with clock.kernel_time():
        spend(0.05)
        with clock.reading_time(), clock.reading_time():  # a plate is read for its matte
            spend(0.2)
    assert 0.05 <= clock.kernel < 0.2


def test_a_kernel_that_waits_spends_no_processor_time() -> None:
    clock = Clock()
    with clock.kernel_time():
        spend(0.2)
    assert clock.kernel_processor < 0.1 <= clock.kernel


FIRST, SECOND = StageId("solve", 0), StageId("solve", 1)


@pytest.fixture
def job(tmp_path: Path):
    job = resolve(write_tiny_shot(tmp_path / "shot", 2)).job
    arrays = {stage.array("material"): "material" for stage in (FIRST, SECOND)}
    FrameStore.create(OutputFolder.of(job).store, arrays, range(2), job.height, job.width)
    return job


def test_a_frame_carried_over_is_committed_with_the_same_content(job) -> None:
    first = Workspace(job, Node(FIRST, 0, (1001,), {"sweep": 0}))
    values = np.random.default_rng(0).random((2, job.height, job.width), dtype=np.float32)
    first.commit(1001, {"material": values})
    second = Workspace(job, Node(SECOND, 0, (1001,), {"sweep": 1}))
    assert second.pending() == (1001,)
    second.carry(1001, "material", FIRST, {"skipped": True})
    assert second.pending() == ()
    np.testing.assert_array_equal(second.read(SECOND, "material", 1001), values)
    old, new = (first.store.shard_path(stage.array("material"), 0) for stage in (FIRST, SECOND))
    assert old.samefile(new)
    record = second.book.find(SECOND, 1001)
    assert record is not None
    assert record.facts["skipped"]


def prepared(path: Path) -> tuple[Session, Node]:
    """A shot whose store is laid out, and its first frame's decomposition."""
    session = Session(path)
    job = session.job
    FrameStore.create(session.output.store, session.plan().arrays(), job.frames, job.height, job.width)
    return session, session.graph().nodes[DECOMPOSE, 0]


def test_a_worker_waits_for_the_one_that_makes_its_frame(tiny_shot: Path) -> None:
    session, node = prepared(tiny_shot)
    held = take_lease(session.output.task_leases, "decompose.1001", patient=False)
    assert held is not None
    thread = threading.Thread(target=run_node, args=(session.job, node))
    thread.start()
    thread.join(0.6)
    assert thread.is_alive()
    assert session.book.find(DECOMPOSE, 1001) is None
    held.release()
    thread.join(20)
    assert session.book.find(DECOMPOSE, 1001) is not None
    assert not list(session.output.task_leases.iterdir())


def test_a_worker_whose_frame_was_taken_over_writes_nothing(tiny_shot: Path) -> None:
    session, node = prepared(tiny_shot)
    space: Workspace = Workspace(session.job, node)
    with space.claimed():
        for file in session.output.task_leases.iterdir():
            file.unlink()
        value = np.zeros((2, session.job.height, session.job.width), np.float32)
        with pytest.raises(LeaseLostError, match="no longer holds the lease"):
            space.commit(1001, {"observed": value})
    assert not (session.output.store / "observed" / "c").exists()
    assert session.book.find(DECOMPOSE, 1001) is None
