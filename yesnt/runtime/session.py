"""A shot and its output folder: what is planned, what is done, and running what is not."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

from yesnt.core.errors import UsageError
from yesnt.core.job_progress import Progress, no_progress
from yesnt.core.stage_id import StageId
from yesnt.io.color_config import convert
from yesnt.io.durable import sweep_partials, write_json
from yesnt.io.jobfile import parse_frames
from yesnt.io.lease import LeaseState
from yesnt.io.output import OutputFolder
from yesnt.io.preview import thumbnail
from yesnt.io.record_index import RecordIndex
from yesnt.io.records import RecordBook
from yesnt.io.store import FrameStore
from yesnt.planning import settings as of
from yesnt.planning.chunks import ChunkPlan, Extent, fits_whole, matte_extent, plan_chunks
from yesnt.planning.frame_grid import DEAD, FrameGrid
from yesnt.planning.graph import Graph, Node, NodeId
from yesnt.planning.resources import needs_gpu
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import FORMER_ARRAYS, STAGES
from yesnt.runtime.driver import Driver, DriverSettings, Outcome, is_done
from yesnt.runtime.input_checks import InputChecks
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.table import check_cluster
from yesnt.runtime.lazy_cluster import LazyCluster
from yesnt.runtime.live_grid import LiveGrid
from yesnt.runtime.preflight import Resolved, resolve
from yesnt.tasks.run import run_node, worker_modules
from yesnt.workflows.shot import shot_graph

Listener = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True)
class RunOptions:
    """What the command line adds to a job.

    Attributes:
        frames: the frames to deliver, as a range; None: all. Their chunks and halos are made too.
        until: the last stage to run; None: all.
        cluster: where tasks run.
        driver: retries and deaths.
    """

    frames: str | None = None
    until: str | None = None
    cluster: ClusterSpec = field(default_factory=ClusterSpec)
    driver: DriverSettings = field(default_factory=DriverSettings)


@dataclass
class RunResult:
    """Result of `Session.run`.

    Attributes:
        outcome: of all passes over the graph.
        missing: (stage, frame) -> why it could not be made.
        warnings: of the input checks.
        output: the output folder.
        dashboard: address of the scheduler's dashboard; "" if no cluster was needed.
    """

    outcome: Outcome = field(default_factory=Outcome)
    missing: dict[tuple[StageId, int], str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    output: Path = Path()
    dashboard: str = ""


@dataclass(frozen=True)
class Missing:
    """Frames that could not be made: (stage, frame) -> reason."""

    reasons: Mapping[tuple[StageId, int], str]

    def frames(self, *stages: str) -> frozenset[int]:
        """Frames missing from any of these stages."""
        return frozenset(frame for stage, frame in self.reasons if stage.name in stages)


class Session:
    """A resolved job and its output folder.

    Args:
        path: the job file or its folder.
        accept_license: licences that the user accepts beside those that the job names.
        progress: called while input files are hashed and checked.
    """

    def __init__(
        self, path: str | Path, accept_license: tuple[str, ...] = (), progress: Progress = no_progress
    ) -> None:
        self.resolved: Resolved = resolve(path, accept_license, progress)
        self.progress = progress
        self.job = self.resolved.job
        self.output = OutputFolder.of(self.job)
        self.book = RecordBook(self.output.records, self.output.root)
        # A plan and a graph are the same as long as the same frames are missing; building a long shot's takes seconds.
        self._plan_without = lru_cache(maxsize=1)(self._make_plan)
        self._graph_without = lru_cache(maxsize=1)(lambda *lost: shot_graph(self._plan_without(*lost)))

    @cached_property
    def checks(self) -> InputChecks:
        """Checks of the input files; what they find is remembered between commands."""
        return InputChecks(self.resolved, self.progress)

    def open_index(self) -> RecordIndex:
        """The index of the records as they are now."""
        return RecordIndex(self.book, self.output.run / "record_index.json")

    def remember(self) -> None:
        """Writes what was learned of the input files to the output folder, so that the next command is fast."""
        with suppress(OSError):
            self.output.run.mkdir(parents=True, exist_ok=True)
        self.resolved.memory.save()
        self.checks.facts.save()

    @cached_property
    def chunks(self) -> ChunkPlan:
        """How the temporal solve is cut; the mattes are looked at only if a full frame would not fit into memory."""
        job, params = self.job, of.energy_params(self.job.shot)
        temporal, length = job.shot.temporal, len(job.frames)
        extent = Extent(job.height, job.width)
        if not fits_whole(temporal, length, extent):
            extent = matte_extent(job)
        return plan_chunks(params, temporal, temporal.tolerance, length, extent)

    def plan(self, missing: Missing | None = None) -> ShotPlan:
        """The nodes' builder; frames in `missing` are done without."""
        return self._plan_without(*self._lost(missing))

    def graph(self, missing: Missing | None = None) -> Graph:
        """All nodes of the shot."""
        return self._graph_without(*self._lost(missing))

    def _lost(self, missing: Missing | None) -> tuple[frozenset[int], ...]:
        """Frames without decomposition, without flow, and without delivery."""
        missing = missing or Missing(self.marked_dead())
        undelivered = missing.frames("confidence", "solve", "relight", "composite")
        return missing.frames("decompose", "window", "correct"), missing.frames("flow"), undelivered

    def _make_plan(self, *lost: frozenset[int]) -> ShotPlan:
        return ShotPlan(self.job, self.resolved.digests, self.resolved.backend, self.chunks, *lost)

    def targets(self, graph: Graph, options: RunOptions) -> list[NodeId]:
        """The nodes that a run is asked for.

        Raises:
            UsageError: an unknown stage, or frames that the shot has not.
        """
        if options.until is not None and options.until not in STAGES:
            raise UsageError(
                f"No stage {options.until!r}", "--until", f"one of {', '.join(STAGES)}", "check its spelling"
            )
        wanted = set(self.job.frames if options.frames is None else parse_frames(options.frames, "--frames"))
        unknown = sorted(wanted - set(self.job.frames))
        if unknown:
            raise UsageError(
                f"The shot has no frame {unknown[0]}", "--frames", self.job.shot.frames, "choose among these"
            )
        last = options.until or ("preview" if options.frames is None else "composite")
        if last in ("preview", "composite") and not wanted.isdisjoint(self.job.frames):
            chosen = [n.id for n in graph if n.stage.label == last and not wanted.isdisjoint(n.frames)]
            return chosen if last == "composite" else [n.id for n in graph if n.stage.label in ("composite", "preview")]
        return [n.id for n in graph if n.stage.name == last and not wanted.isdisjoint(n.frames)]

    def check_cluster(self, spec: ClusterSpec) -> ClusterSpec:
        """The cluster as this job uses it.

        Raises:
            UsageError: it cannot run the job, for example because no worker has the GPU that the backend is made for.
            MissingPartError: the kind of cluster needs a package that is absent.
        """
        where = spec.of_job(needs_gpu(self.job.shot), self.output.run)
        check_cluster(where)
        return where

    def run(self, options: RunOptions, listen: Listener = lambda event: None) -> RunResult:
        """Runs what is not done; frames that cannot be had are left out so that all others finish.

        Raises:
            YesntError: bad input, a full disk, a lost scheduler.
        """
        where = self.check_cluster(options.cluster)
        graph = self.graph()
        wanted = graph.closure(self.targets(graph, options))  # wrong options are refused before anything is written
        warnings = self.checks.form()
        result = RunResult(warnings=warnings, output=self.output.root)
        with LazyCluster(where, worker_modules(self.job.shot)) as cluster:
            if any(not is_done(self.book, node) for node in wanted):
                cluster.begin(listen)
            result.warnings += self.checks.content()
            gone: list[LeaseState] = []
            with self.output.lock(gone.append), self._live_grid() as grid, self._events(listen, grid) as tell:
                for state in gone:
                    tell(
                        {"event": "taken_over", "time": time.time(), "owner": str(state.owner or "an unknown process")}
                    )
                self.remember()
                sweep_partials(self.output.root)
                self.book.keep_only(self.job.frames)
                self.output.exr.mkdir(parents=True, exist_ok=True)
                result.missing = dict(self.marked_dead())
                while self._pass(options, result, cluster, tell, grid):
                    pass
                self._sweep_transients()
                self._index_records()
                result.dashboard = cluster.dashboard
        return result

    def _pass(
        self, options: RunOptions, result: RunResult, cluster: LazyCluster, tell: Listener, grid: LiveGrid
    ) -> bool:
        """Drives the graph once; True if frames were lost that the next pass must do without."""
        known = Missing(dict(result.missing))
        plan, graph = self.plan(known), self.graph(known)
        graph = graph.closure(self.targets(graph, options))
        FrameStore.create(
            self.output.store, plan.arrays(), self.job.frames, self.job.height, self.job.width
        )  # fmt: skip
        driver = Driver(self.job, graph, self.book, run_node, options.driver, tell)
        reused = driver.reuse()
        tell({"event": "plan", "stages": _count(graph), "reused": _count_ids(reused.reused)})
        grid.lay_out(graph, reused.reused)
        outcome = driver.run(grid.published(cluster.client(tell))) if driver.remaining else reused
        _merge(result.outcome, outcome)
        for reasons in (outcome.failed, outcome.dead):
            for node_id, reason in reasons.items():
                node = graph.nodes[node_id]
                result.missing |= {(node.stage, frame): reason for frame in node.frames}
                if reasons is outcome.dead:
                    self._mark_dead(node, reason)
        lost = {stage.name for stage, _ in (*outcome.failed, *outcome.dead)}
        found = len(result.missing) > len(known.reasons)  # else the next pass would fail alike
        return bool(found and outcome.blocked and lost - {"preview"})  # a video cannot leave out frames of its own

    def _index_records(self) -> None:
        """Brings the record index up to date, so that the next `status` reads no records."""
        index = self.open_index()
        for node in (node for node in self.graph() if not node.transient):
            for frame in node.frames:
                index.find(node.stage, frame)
        index.save()

    def _sweep_transients(self) -> None:
        """Removes transient results once all their users are done: earlier sweeps, windows, video segments."""
        graph = self.graph()
        kept = [node for node in graph if not node.transient]
        for name in {node.stage.name for node in graph if node.transient}:
            passing = {node.id for node in graph if node.transient and node.stage.name == name}
            served = [node for node in kept if not passing.isdisjoint(node.needs)]
            if all(is_done(self.book, node) for node in served):
                # Records first: no record without its frame.
                for folder in (self.book.folder, self.output.store, self.output.segments):
                    for transient in folder.glob(f"{name}.*"):
                        shutil.rmtree(transient)
        self._sweep_former()

    def _sweep_former(self) -> None:
        """Removes records and arrays that older versions kept under other names."""
        for name in (row.former_name for row in STAGES.values() if row.former_name):
            shutil.rmtree(self.book.folder / name, ignore_errors=True)
        for name in FORMER_ARRAYS:
            shutil.rmtree(self.output.store / name, ignore_errors=True)

    def marked_dead(self) -> dict[tuple[StageId, int], str]:
        """Frames that killed their workers in an earlier run; `retry` takes the marks away."""
        marks = {}
        for path in sorted(self.output.dead.glob("*/*.json")):
            document = json.loads(path.read_text())
            stage = StageId.parse(document["stage"])
            if stage.name in STAGES:  # else another version of the product left it
                marks[stage, document["frame"]] = document["reason"]
        return marks

    def _mark_dead(self, node: Node, reason: str) -> None:
        for frame in node.frames:
            path = self.output.dead / node.stage.label / f"{frame:04d}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, {"stage": node.stage.label, "frame": frame, "reason": reason})

    @contextmanager
    def _live_grid(self) -> Iterator[LiveGrid]:
        """The state of the run, which the dashboard shows."""
        grid = FrameGrid(self.job.frames, self.job.width * self.job.height / 1e6)
        for (stage, frame), reason in self.marked_dead().items():
            grid.lose(stage.name, frame, DEAD, reason)
        show = partial(convert, conversion=self.job.colors.display)
        live = LiveGrid(
            self.job.shot.name, grid, lambda frame: thumbnail(self.output.exr_path(self.job.shot.name, frame), show)
        )
        try:
            yield live
        finally:
            live.close()

    @contextmanager
    def _events(self, listen: Listener, grid: LiveGrid) -> Iterator[Listener]:
        """Every event goes to the event log, to the frame grid and to the listener."""
        with self.output.events.open("a", encoding="utf-8") as stream:

            def tell(event: Mapping[str, Any]) -> None:
                stream.write(json.dumps(event, default=str) + "\n")
                stream.flush()
                grid.apply(event)
                listen(event)

            yield tell


def _count(graph: Graph) -> dict[str, int]:
    return _count_ids(list(graph.nodes))


def _count_ids(ids: list[NodeId]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for stage, _ in ids:
        counts[stage.name] = counts.get(stage.name, 0) + 1
    return counts


def _merge(total: Outcome, one: Outcome) -> None:
    total.done += one.done
    if not total.reused:
        total.reused += one.reused
    total.failed |= one.failed
    total.dead |= one.dead
    total.busy_seconds += one.busy_seconds
    total.kernel_seconds += one.kernel_seconds
