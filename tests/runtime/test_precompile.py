"""Kernels are compiled once, before work, and nothing is left to compile for the tasks."""

import asyncio
import json
import subprocess
import sys
import threading
import time

import pytest

from tests.capture.capture_shot import write_capture_shot
from tests.tasks.test_fit import write_capture_shot as write_fitted_shot
from yesnt.cli.text import compiling_line
from yesnt.planning.graph import Graph
from yesnt.planning.stages import STAGES
from yesnt.runtime.cluster import precompile, prepare_workers
from yesnt.runtime.cluster.precompile import Precompilation, Unit, compile_missing
from yesnt.runtime.cluster.prepare_workers import prepare_plugin
from yesnt.runtime.session import Session

SIGNATURES = """
import gc, json
from numba.core.registry import CPUDispatcher
found = {}
for kernel in (one for one in gc.get_objects() if isinstance(one, CPUDispatcher)):
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
    if name.startswith("yesnt.") and kernel.signatures:
        found.setdefault(name, []).extend(str(signature) for signature in kernel.signatures)
print(json.dumps(found))
"""
"""Prints what has been compiled, or loaded from the cache, in a process."""


def signatures(code: str) -> set[tuple[str, str]]:
    command = [sys.executable, "-c", code + SIGNATURES]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return {(name, one) for name, several in json.loads(output.splitlines()[-1]).items() for one in several}


def test_tasks_find_every_kernel_compiled(tiny_shot, tmp_path):
    """With a warm cache both processes load the kernels that they call from Python, and no others."""
    compile_all = "from yesnt.runtime.cluster.precompile import UNITS\nfor unit in UNITS: unit.compile()\n"
    tasks = "from pathlib import Path\nfrom tests.in_process import run_here\n"
    tasks += f"run_here(Path({str(tiny_shot)!r}), 'relight')\n"
    captured = write_capture_shot(tmp_path / "captured", cameras=2, frames=1, evidence={"use": True})
    tasks += f"run_here(Path({str(captured)!r}), 'evidence')\n"
    knobs = {"steps": 4, "every": 2, "check": 2, "count": 100}
    fitted = write_fitted_shot(tmp_path / "fitted", 1, gaussians={"held_out": 1, "knobs": knobs})
    tasks += f"for until in ('mesh', 'view'): run_here(Path({str(fitted)!r}), until)\n"
    compiled, used = signatures(compile_all), signatures(tasks)
    used = {(name, one) for name, one in used if not name.startswith("yesnt.capture.")}  # compiled by the checks
    assert {name for name, _ in used} >= {
        "yesnt.gaussians.backward.tile_gradients", "yesnt.gaussians.opacity._accumulate",
        "yesnt.relight.kernels._sum_pixels", "yesnt.temporal.kernels.gradient",
        "yesnt.decompose.evidence.fit._fit_points",
    }  # fmt: skip
    assert used <= compiled


@pytest.fixture
def units(tmp_path, monkeypatch):
    """Two units that only note that they were compiled."""
    calls = []

    class Noting(Unit):
        @property
        def marker(self):
            return tmp_path / f"{self.function}.done"

        def compile(self):
            calls.append(self.function)
            time.sleep(0.2)
            self.marker.touch()

    found = (Noting("fake", "one", frozenset({"relight", "set"})), Noting("fake", "two", frozenset({"fit"})))
    monkeypatch.setattr(precompile, "UNITS", found)
    return calls


def test_units_are_shared_by_all_who_compile_at_once(units):
    threads = [threading.Thread(target=compile_missing) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(units) == ["one", "two"]


def test_a_second_run_compiles_nothing(units):
    compile_missing()
    compile_missing()
    assert units == ["one", "two"]
    events = []
    Precompilation().wait(events.append)
    assert events == []


def test_kernels_of_stages_that_do_not_run_are_not_compiled(units):
    compile_missing(frozenset({"decompose", "fit"}))
    assert units == ["two"]
    assert [unit.function for unit in precompile.missing_units(frozenset({"relight"}))] == ["one"]
    assert precompile.missing_units(frozenset({"fit"})) == []
    events = []
    Precompilation(frozenset({"fit", "solve"})).wait(events.append)
    assert events == []


def test_the_stages_of_a_run_are_those_of_its_graph_and_what_follows_views(tiny_shot, tmp_path):
    session = Session(tiny_shot)
    graph = session.graph()
    assert precompile.used_stages(session.job.shot, graph, False) == {node.stage.name for node in graph}
    shot = Session(write_fitted_shot(tmp_path, 1)).job.shot
    assert precompile.used_stages(shot, Graph(), False) == frozenset()
    assert precompile.used_stages(shot, Graph(), True) >= {"relight", "solve"}
    assert precompile.used_stages(shot, Graph(), True).isdisjoint({"set"})
    every = {stage for unit in precompile.UNITS for stage in unit.stages}
    assert every <= STAGES.keys()


def test_the_compilers_of_a_run_are_told_its_stages(monkeypatch):
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda command, **rest: started.append(command[-1]))
    precompile._start_compiler(frozenset({"fit", "bake"}))
    assert started[0].endswith("c(frozenset(['bake', 'fit']))")
    precompile._start_compiler(None)
    assert started[1].endswith("c(None)")


def test_progress_is_reported_while_processes_compile(units, tmp_path, monkeypatch):
    sleeper = [sys.executable, "-c", "import time; time.sleep(0.6)"]
    monkeypatch.setattr(precompile, "_start_compiler", lambda stages: subprocess.Popen(sleeper))
    monkeypatch.setattr(precompile, "REPORT_SECONDS", 0.2)
    compilation, events = Precompilation(), []
    (tmp_path / "one.done").touch()
    compilation.wait(events.append)
    compilation.close()
    assert [event["event"] for event in events][-1] == "compiled"
    assert len(events) >= 3
    assert events[0] == {"event": "compiling", "done": 1, "total": 2, "seconds": events[0]["seconds"]}
    assert compiling_line({"done": 1, "total": 2, "seconds": 12.3}) == "compiling kernels 1/2 (once per version), 12 s"


def test_a_compiler_that_fails_does_not_stop_the_run(units, monkeypatch):
    monkeypatch.setattr(
        precompile, "_start_compiler", lambda stages: subprocess.Popen([sys.executable, "-c", "exit(3)"])
    )
    events = []
    compilation = Precompilation()
    compilation.wait(events.append)
    compilation.close()
    assert events[-1]["failed"] == ["exit status 3", "exit status 3"]
    line = compiling_line(events[-1])
    assert line.endswith("; a compiler ended with exit status 3, tasks compile what they lack")


def test_a_run_that_ends_early_ends_its_compilers(units, monkeypatch):
    sleeper = [sys.executable, "-c", "import time; time.sleep(60)"]
    monkeypatch.setattr(precompile, "_start_compiler", lambda stages: subprocess.Popen(sleeper))
    compilation, events = Precompilation(), []
    waiting = threading.Thread(target=compilation.wait, args=(events.append,))
    waiting.start()
    compilation.close()
    waiting.join(10)
    assert not waiting.is_alive()
    assert "compiled" not in [event["event"] for event in events]


@pytest.fixture
def unpinned(monkeypatch):
    """A worker pins the libraries of its process; this process is not ours to pin."""
    monkeypatch.setattr(prepare_workers, "THREAD_VARIABLES", ())
    monkeypatch.setattr(prepare_workers, "pin_threads", dict)


@pytest.mark.parametrize(
    ("compiles", "modules", "expected"), [(True, ("json",), 2), (False, ("json",), 0), (True, (), 0)]
)
def test_workers_of_another_cluster_compile_what_is_missing(units, unpinned, compiles, modules, expected):
    """The workers of our own cluster find everything compiled; one that runs no tasks of ours needs nothing."""
    asyncio.run(prepare_plugin(modules, compiles).setup(None))
    assert len(units) == expected


def test_a_worker_that_cannot_compile_still_joins(unpinned, monkeypatch):
    monkeypatch.setattr(prepare_workers, "compile_missing", lambda stages: 1 / 0)
    asyncio.run(prepare_plugin(("json",), True).setup(None))
