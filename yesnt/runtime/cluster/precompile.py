"""Compiles the kernels of a run's stages before its work starts, once per version of their sources.

Machine code is cached on disk (core/kernel_cache.py). Kernels are compiled in units, each in one process at a time: a
unit is locked while it is compiled and leaves a marker file when it is done. Any number of processes can therefore
share the units of one host. A run starts two processes for its own cluster; workers of a cluster that was started
elsewhere compile what is missing when they join a run.
"""

from __future__ import annotations

import fcntl
import importlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.kernel_cache import kernel_folder
from yesnt.core.shot import Shot
from yesnt.planning.graph import Graph
from yesnt.planning.stages import BAKE, EVIDENCE, FIT, MESH, RELIGHT, SET, SOLVE, STAGES, VIEW

PROCESSES = 2
"""Processes that compile side by side. More would wait for the largest unit."""

REPORT_SECONDS = 3.0
"""Time between two progress events."""

POLL_SECONDS = 0.1


@dataclass(frozen=True)
class Unit:
    """Kernels that are compiled together.

    Attributes:
        package: whose kernels they are; its cache folder holds them.
        function: of the package's module `precompile`; calls the kernels on tiny arrays.
        stages: names of the stages whose tasks call them.
    """

    package: str
    function: str
    stages: frozenset[str] = frozenset()

    @property
    def marker(self) -> Path | None:
        """The file that tells that the unit is compiled; None if nothing can be cached."""
        folder = kernel_folder(self.package)
        return None if folder is None else folder / f"{self.function}.done"

    @property
    def done(self) -> bool:
        """Whether nothing is left to compile, or nothing could be kept."""
        return self.marker is None or self.marker.exists()

    def compile(self) -> None:
        """Compiles the unit in this process and leaves the marker."""
        getattr(importlib.import_module(f"{self.package}.precompile"), self.function)()
        assert self.marker is not None
        self.marker.touch()


_LIT = frozenset({RELIGHT.name, EVIDENCE.name, SET.name, BAKE.name})
_FITTED = frozenset({FIT.name, MESH.name, VIEW.name})

UNITS = (
    Unit("yesnt.relight", "precompile_lobes", _LIT),
    Unit("yesnt.gaussians", "precompile_fit", _FITTED),
    Unit("yesnt.temporal", "precompile_solver", frozenset({SOLVE.name})),
    Unit("yesnt.relight", "precompile_shadows", _LIT),
    Unit("yesnt.decompose.evidence", "precompile_evidence", frozenset({EVIDENCE.name})),
    Unit("yesnt.scene", "precompile_set", frozenset({SET.name})),
)
"""All units, the longest first."""

Stages = frozenset[str] | None
"""Names of the stages whose kernels are wanted; None: those of all."""


def used_stages(shot: Shot, graph: Graph, to_come: bool) -> frozenset[str]:
    """Stages of a run's graph; with `to_come` also those of the job that follow once more is known of it."""
    found = {node.stage.name for node in graph}
    if to_come:
        unused = {SET.name} if shot.set is None else set()
        unused |= {EVIDENCE.name} if shot.captured is None and not shot.evidence.time else set()
        found |= STAGES.keys() - unused
    return frozenset(found)


def missing_units(stages: Stages = None) -> list[Unit]:
    """Units that the stages' tasks need and that are not compiled yet."""
    return [unit for unit in UNITS if not unit.done and (stages is None or not stages.isdisjoint(unit.stages))]


def compile_missing(stages: Stages = None) -> None:
    """Compiles what is missing in this process; units that another process compiles are waited for."""
    for wait in (False, True):
        for unit in missing_units(stages):
            with _locked(unit, wait) as locked:
                if locked and not unit.done:
                    unit.compile()


@contextmanager
def _locked(unit: Unit, wait: bool) -> Iterator[bool]:
    """Holds a unit's lock; yields False if another process holds it and it is not waited for."""
    assert unit.marker is not None
    with unit.marker.with_suffix(".lock").open("w") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
            return
        except OSError:  # a file system without locks: better compiled twice than not at all
            pass
        yield True


class Precompilation:
    """The processes that compile what is missing; progress is reported as events `compiling` and `compiled`.

    Args:
        stages: whose kernels are wanted; None: those of all.
    """

    def __init__(self, stages: Stages = None) -> None:
        self._started, self._stages = time.monotonic(), stages
        self._count = len(missing_units(stages))
        self._running = [_start_compiler(stages) for _ in range(min(PROCESSES, self._count))]
        self._stopped = False

    def wait(self, report: Callable[[Mapping[str, Any]], None]) -> None:
        """Waits until all kernels are compiled and reports every `REPORT_SECONDS`.

        A process that fails is reported and not raised: a task compiles what it lacks, or says why it cannot.
        """
        reported = -REPORT_SECONDS
        while any(process.poll() is None for process in self._running):
            seconds = time.monotonic() - self._started
            if seconds - reported >= REPORT_SECONDS:
                reported = seconds
                report(self._event("compiling"))
            time.sleep(POLL_SECONDS)
        if self._running and not self._stopped:
            failed = [f"exit status {process.returncode}" for process in self._running if process.returncode]
            report(self._event("compiled") | ({"failed": failed} if failed else {}))

    def close(self) -> None:
        """Ends the processes; what is compiled stays."""
        self._stopped = True
        for process in self._running:
            process.kill()
            process.wait()

    def _event(self, kind: str) -> dict[str, Any]:
        seconds = round(time.monotonic() - self._started, 1)
        return {
            "event": kind,
            "done": self._count - len(missing_units(self._stages)),
            "total": self._count,
            "seconds": seconds,
        }


def _start_compiler(stages: Stages) -> subprocess.Popen[bytes]:
    """A process that imports the same package as this one and compiles what is missing.

    Its error output is dropped: the task that lacks a kernel compiles it again and records the error.
    """
    wanted = "None" if stages is None else f"frozenset({sorted(stages)})"
    code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import compile_missing as c; c({wanted})"
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.DEVNULL)
