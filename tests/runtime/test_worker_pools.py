"""CPU and GPU workers: tasks go to their pool, and a pool that nobody offers is refused or reported."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from distributed import Client, LocalCluster, Worker

from tests.fake_tasks import A, B, FakeTask, fake_task
from yesnt.core.errors import UsageError
from yesnt.core.material_input import DecomposeInput
from yesnt.core.shot import GBufferInput, Job, LightInput, PlateInput, Shot
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Graph, Node
from yesnt.planning.resources import needs_gpu, runs_on_gpu
from yesnt.planning.task_records import RelightTask
from yesnt.runtime.cluster.worker_settings import dask_settings
from yesnt.runtime.driver import worker_pools
from yesnt.runtime.driver.driver import Driver, DriverSettings
from yesnt.runtime.driver.worker_pools import ANY, WorkerPools

CPU_WORKER, GPU_WORKER, PLAIN = {"CPU": 1.0}, {"GPU": 1.0}, {}
STAGES = frozenset({"a"})


def pools(*offers: dict, expected: tuple[str, ...] = ()) -> WorkerPools:
    made = WorkerPools(STAGES, expected)
    made.update({f"tcp://h:{i}": offer for i, offer in enumerate(offers)})
    return made


@pytest.mark.parametrize(
    ("offers", "gpu", "other"),
    [
        ((CPU_WORKER, GPU_WORKER), "GPU", "CPU"),
        ((PLAIN, GPU_WORKER), "GPU", ANY),
        ((GPU_WORKER,), "GPU", ANY),
        ((PLAIN, PLAIN), ANY, ANY),
        ((), ANY, ANY),
    ],
)
def test_each_stage_asks_for_what_is_offered(offers: tuple[dict, ...], gpu: str, other: str) -> None:
    found = pools(*offers)
    assert (found.pool_of("a"), found.pool_of("b")) == (gpu, other)


def test_a_job_without_gpu_tasks_uses_every_worker() -> None:
    made = WorkerPools()
    made.update({"tcp://h:1": GPU_WORKER, "tcp://h:2": CPU_WORKER})
    assert made.pool_of("a") == ANY
    assert not made.divided


def test_a_pool_takes_as_many_tasks_as_it_has_workers() -> None:
    found = pools(CPU_WORKER, CPU_WORKER, GPU_WORKER)
    assert found.has_room("b", ["b"])
    assert not found.has_room("b", ["b", "b"])
    assert found.has_room("a", ["b", "b"])
    assert not found.has_room("a", ["a"])
    assert set(found.workers_of("a", {"tcp://h:0": 1, "tcp://h:2": 1})) == {"tcp://h:2"}


def test_a_gpu_that_no_worker_offers_is_refused() -> None:
    with pytest.raises(UsageError, match=r"No worker of the cluster offers a GPU.*--resources GPU=1"):
        pools(CPU_WORKER)
    assert not pools(CPU_WORKER, expected=("CPU", "GPU")).has_room("a", []), "a launcher's GPU worker is still to come"


def test_a_pool_that_is_still_to_come_is_waited_for_aloud(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(worker_pools.time, "monotonic", lambda: clock.now)
    found = pools(CPU_WORKER, expected=("CPU", "GPU"))
    assert found.newly_absent(["a", "b"]) == ""
    clock.now += 5
    assert found.newly_absent(["a", "b"]) == "no GPU worker has joined; the tasks for it wait, all others go on"
    assert found.newly_absent(["a", "b"]) == "", "told once"
    found.update({"x": CPU_WORKER, "y": GPU_WORKER})
    assert found.newly_absent(["a", "b"]) == ""


def test_only_networks_that_are_made_for_a_gpu_need_one() -> None:
    for decompose, gpu in (({"backend": "marigold"}, True), ({"backend": "embedded"}, False), ({"path": "x"}, False)):
        shot = SimpleNamespace(decompose=DecomposeInput(**decompose))
        assert needs_gpu(shot) is gpu  # type: ignore[arg-type]
    assert not runs_on_gpu(SimpleNamespace(task=RelightTask.__new__(RelightTask)))  # type: ignore[arg-type]


@pytest.fixture
def client() -> Iterator[Client]:
    """A worker of each pool, in this process."""
    import dask

    with (
        dask.config.set(dask_settings()),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, resources={"CPU": 1},
            silence_logs=50,
        ) as cluster,
    ):  # fmt: skip
        ((_, row),) = cluster.new_worker_spec().items()
        cluster.worker_spec["gpu"] = {"cls": Worker, "options": {**row["options"], "resources": {"GPU": 1}}}
        cluster.sync(cluster._correct_state)
        with Client(cluster, set_as_default=False) as client:
            client.wait_for_workers(2)
            yield client


def test_the_driver_sends_each_task_to_its_pool(tmp_path: Path, client: Client) -> None:
    shot = Shot(
        version=1, name="x", frames="0-9", plate=PlateInput(path="p"), gbuffer=GBufferInput(path="g"), camera="c",
        light=LightInput(path="l"),
    )  # fmt: skip
    job = Job(shot=shot, root=str(tmp_path), frames=tuple(range(6)), width=1, height=1)
    nodes = [Node(A, i, (i,), {"a": i}, (), FakeTask()) for i in range(6)]
    nodes += [Node(B, i, (i,), {"b": i}, (), FakeTask()) for i in range(6)]
    events: list = []
    settings = DriverSettings(gpu_stages=STAGES, pools=frozenset({"CPU", "GPU"}))
    driver = Driver(job, Graph(nodes), RecordBook(tmp_path / "records"), fake_task, settings, events.append)
    driver.reuse()
    assert driver.run(client).complete
    workers = client.scheduler_info(n_workers=-1)["workers"]
    offered = {event["stage"]: set() for event in events if event["event"] == "done"}
    for event in events:
        if event["event"] == "done":
            offered[event["stage"]] |= set(workers[event["worker"]]["resources"])
    assert offered == {"a": {"GPU"}, "b": {"CPU"}}
