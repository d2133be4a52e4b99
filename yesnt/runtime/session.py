"""A shot and its output folder: what is planned, what is done, and running what is not."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

from yesnt.core.job_progress import Progress, no_progress
from yesnt.io.color_config import convert
from yesnt.io.dead_marks import DeadMarks, Marks
from yesnt.io.durable import sweep_partials
from yesnt.io.lease import Lease, LeaseState
from yesnt.io.output import OutputFolder
from yesnt.io.preview import Presentation, thumbnail
from yesnt.io.record_index import RecordIndex
from yesnt.io.records import RecordBook
from yesnt.io.store import FrameStore
from yesnt.planning import settings as of
from yesnt.planning.builders.gaussians import gaussian_nodes
from yesnt.planning.builders.matte import matte_nodes
from yesnt.planning.chunks import ChunkPlan, Extent, fits_whole, matte_extent, plan_chunks
from yesnt.planning.frame_grid import DEAD, FrameGrid
from yesnt.planning.graph import Graph, Node, NodeId, stage_counts
from yesnt.planning.resources import needs_gpu, runs_on_gpu
from yesnt.planning.shot_plan import MATTES, VIEWS, ShotPlan
from yesnt.planning.stages import COMPOSITING, STAGES
from yesnt.runtime.awaited import ends_with, refuse_awaiting, refuse_unchanged
from yesnt.runtime.checks.inputs import InputChecks
from yesnt.runtime.checks.preflight import Resolved, resolve
from yesnt.runtime.clamps import clamp_lines
from yesnt.runtime.cluster.lazy_cluster import LazyCluster
from yesnt.runtime.cluster.precompile import used_stages
from yesnt.runtime.control.submission import submission_of_this_process
from yesnt.runtime.driver.driver import Driver, Outcome, is_done
from yesnt.runtime.driver.supervisor import Supervisor, Watched
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.launchers.table import check_cluster, launcher_of
from yesnt.runtime.left_out import NOTHING_MISSING, LeftOut, Missing, frames_before_gaps, left_out
from yesnt.runtime.live_grid import LiveGrid
from yesnt.runtime.run_log import RunLog, open_run_log
from yesnt.runtime.run_options import (
    Forced,
    RunOptions,
    RunResult,
    check_stage,
    forget_with_users,
    parse_force,
    wanted_frames,
    wanted_order,
)
from yesnt.runtime.sweep import sweep_transients
from yesnt.tasks.run import run_node, worker_modules
from yesnt.workflows.shot import shot_graph

Listener = Callable[[Mapping[str, Any]], None]


class Session:
    """A resolved job and its output folder.

    Args:
        path: the job file or its folder.
        accept_license: licences that the user accepts beside those that the job names.
        progress: called while input files are hashed and checked.
        as_run: frames that the last run had to leave out are left out, so that the others' state is seen; for verbs
            that only look. A run tries these frames again.
    """

    def __init__(
        self, path: str | Path, accept_license: tuple[str, ...] = (), progress: Progress = no_progress,
        as_run: bool = False,
    ) -> None:  # fmt: skip
        self._resolve = partial(resolve, path, accept_license, progress)
        self.progress = progress
        self.take_all_frames()
        if as_run and self.resolved.awaiting and (left := LeftOut.read(self.output.run).of(self.job.frames)):
            self._take(self._resolve(left_out=left))
            self._look_for_stale()
            if self.resolved.awaiting:  # what the other frames need is not there either
                self.take_all_frames()

    def take_all_frames(self) -> None:
        """Takes the job with all of its frames, those that the last run left out included."""
        self._take(self._resolve())
        self._look_for_stale()

    def _look_for_stale(self) -> None:
        """Finds out whether what the run makes for itself is there but out of date."""
        left = dict(self.job.left_out)
        if self.job.shot.matted is not None and self.resolved.awaiting != MATTES and not self._made(matte_nodes):
            self._take(self._resolve(awaiting=MATTES, left_out=left))
        elif self.job.shot.made and not self.resolved.awaiting and not self._made(gaussian_nodes):
            self._take(self._resolve(awaiting=VIEWS, left_out=left))

    def _take(self, resolved: Resolved) -> None:
        """Takes a job as it is resolved now, and forgets what was derived from it as it was before."""
        self.resolved, self.job = resolved, resolved.job
        self.output = OutputFolder.of(self.job)
        self.book = RecordBook(self.output.records, self.output.root)
        for name in ("checks", "chunks"):
            self.__dict__.pop(name, None)
        # A plan and a graph are the same as long as the same frames are missing; building a long shot's takes seconds.
        self._plan_without = lru_cache(maxsize=1)(self._make_plan)
        self._graph_without = lru_cache(maxsize=1)(lambda *lost: shot_graph(self._plan_without(*lost)))

    def _made(self, nodes: Callable[[ShotPlan], Iterable[Node]]) -> bool:
        """Whether all that the run makes by these nodes for itself is there and up to date."""
        index = self.open_index()
        return all(is_done(index, node) for node in nodes(self.plan()))

    def look_again(self, missing: Missing = NOTHING_MISSING) -> bool:
        """Resolves the job once more, after pictures that it reads were made, as far as they could be.

        Returns:
            Whether any frame is left.
        """
        before = self.resolved.awaiting
        left = left_out(self.job, before, self.plan(missing), missing, self.open_index())
        left.write(self.output.run)
        if not set(self.job.frames).difference(left.stages):
            return False
        self._take(self._resolve(left_out=left.stages))
        self._look_for_stale()
        refuse_unchanged(before, self.resolved.awaiting, self.job.root)
        return True

    def refuse_awaiting(self) -> None:
        """Refuses a job whose plates are still to be made from Gaussian fields, for verbs that read plates.

        Raises:
            JobError: as said.
        """
        refuse_awaiting(self.resolved.awaiting, self.output.root, self.job.shot.made)

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
        self.resolved.plate_headers.save()
        self.checks.facts.save()

    @cached_property
    def chunks(self) -> ChunkPlan:
        """How the temporal solve is cut; the mattes are looked at only if a full frame would not fit into memory.

        Plates that are still to be made cannot be looked at; what they are made from does not depend on the cut.
        """
        job, params = self.job, of.energy_params(self.job.shot)
        temporal, length = job.shot.temporal, len(job.frames)
        extent = Extent(job.height, job.width)
        if not self.resolved.awaiting and not fits_whole(temporal, length, extent):
            extent = matte_extent(job)
        return plan_chunks(params, temporal, temporal.tolerance, length, extent)

    def plan(self, missing: Missing | None = None) -> ShotPlan:
        """The nodes' builder; frames in `missing` are done without."""
        return self._plan_without(*self._lost(missing))

    def graph(self, missing: Missing | None = None) -> Graph:
        """All nodes of the shot."""
        return self._graph_without(*self._lost(missing))

    def _lost(self, missing: Missing | None) -> tuple[frozenset[int], ...]:
        """Frames without decomposition, without flow, without delivery, and without a fit."""
        missing = missing or Missing(self.marked_dead())
        undelivered = missing.frames("confidence", "solve", "relight", "composite")
        unlinked = missing.frames("flow") | frames_before_gaps(self.job)
        absent = missing.frames("decompose", "window", "evidence", "correct")
        return absent, unlinked, undelivered, missing.frames("fit")

    def _make_plan(self, *lost: frozenset[int]) -> ShotPlan:
        resolved = self.resolved
        absent, unlinked, undelivered, unfitted = lost
        return ShotPlan(
            self.job, resolved.digests, resolved.backend, self.chunks, absent, unlinked, undelivered,
            resolved.capture.views, resolved.awaiting, unfitted,
        )  # fmt: skip

    def targets(self, graph: Graph, options: RunOptions) -> list[NodeId]:
        """The nodes that a run is asked for.

        Raises:
            UsageError: an unknown stage, or frames that the shot has not.
        """
        check_stage(options.until, "--until")
        wanted = set(wanted_frames(self.job, options.frames))
        if self.resolved.awaiting and not ends_with(self.resolved.awaiting, options.until):
            return [n.id for n in graph]  # what follows needs all frames
        last = options.until or ("preview" if options.frames is None else "composite")
        if last in ("preview", "composite") and not wanted.isdisjoint(self.job.frames):
            chosen = [n.id for n in graph if n.stage.label == last and not wanted.isdisjoint(n.frames)]
            if last == "preview":
                chosen = [n.id for n in graph if n.stage.label in ("composite", "preview")]
            return [*chosen, *(n.id for n in graph if n.stage == COMPOSITING)]
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
        if self.job.left_out:
            self.take_all_frames()
        graph = self.graph()
        wanted = graph.closure(self.targets(graph, options))  # wrong options are refused before anything is written
        warnings = self.checks.form()
        result = RunResult(warnings=warnings, notes=self.checks.notes, output=self.output.root)
        forced = [parse_force(self.job, text) for text in options.force]
        index = self.open_index()
        awaiting = self.resolved.awaiting
        to_come = bool(awaiting) and not ends_with(awaiting, options.until)
        stages = used_stages(self.job.shot, wanted, to_come)
        with LazyCluster(where, worker_modules(self.job.shot), stages) as cluster:
            if forced or any(not node.transient and not is_done(index, node) for node in wanted):
                cluster.begin(listen)
            result.warnings += self.checks.content()
            gone: list[LeaseState] = []
            with self.output.lock(gone.append) as lease, self._live_grid() as grid:
                log = RunLog(self.output.run_state, lease, submission_of_this_process())
                with open_run_log(log, self.output.events, (grid.apply, listen)) as tell:
                    supervisor = self._supervisor(log, lease, options, tell)
                    run = _Run(options, result, cluster, tell, grid, supervisor, index)
                    try:
                        self._run_all(run, forced, gone)
                    except BaseException as error:
                        log.end(error, 0)
                        raise
                    log.end(None, len(result.missing))
                result.dashboard = cluster.dashboard
        return result

    def _run_all(self, run: _Run, forced: list[Forced], gone: list[LeaseState]) -> None:
        """Everything that only the holder of the lease may do."""
        for state in gone:
            owner = str(state.owner or "an unknown process")
            run.tell({"event": "taken_over", "time": time.time(), "owner": owner})
        self.remember()
        LeftOut().write(self.output.run)
        sweep_partials(self.output.root)
        self.book.keep_only(self.job.frames)
        for force in forced:
            forget_with_users(self.graph(), self.book, force)
        self.output.exr.mkdir(parents=True, exist_ok=True)
        run.result.missing = dict(self.marked_dead())
        self._drive(run)
        run.supervisor.confirm()
        self._index_records(run.index)
        sweep_transients(self.graph(), run.index, self.output)
        run.result.warnings += clamp_lines(self.job.frames, self.graph(), run.index)

    def _drive(self, run: _Run) -> None:
        """All passes; what is made from Gaussian fields comes first, since nothing is known of it before."""
        while self.resolved.awaiting:
            while self._pass(run):
                pass
            ends = ends_with(self.resolved.awaiting, run.options.until)
            if ends or not self.look_again(Missing(dict(run.result.missing))):
                return
            run.result.notes = self.checks.notes
            found = self.checks.form(beside_others=True) + self.checks.content()
            run.result.warnings = list(dict.fromkeys([*run.result.warnings, *found]))
            self.remember()
        while self._pass(run):
            pass

    def _supervisor(self, log: RunLog, lease: Lease, options: RunOptions, tell: Listener) -> Supervisor:
        """Watches the run's commands, its lease, and that there is room for the frames under way."""
        frame = self.job.width * self.job.height * sum(row.cost.disk_bytes_per_pixel for row in STAGES.values())
        names = tuple(name for name in (log.run, submission_of_this_process()) if name)
        room = int(frame * max(2, options.cluster.workers))
        return Supervisor(Watched(names, self.output.commands, lease, self.output.root, room), tell)

    def _pass(self, run: _Run) -> bool:
        """Drives the graph once; True if frames were lost that the next pass must do without."""
        result, tell = run.result, run.tell
        known = Missing(dict(result.missing))
        plan, graph = self.plan(known), self.graph(known)
        graph = graph.closure(self.targets(graph, run.options))
        FrameStore.create(
            self.output.store, plan.arrays(), self.job.frames, self.job.height, self.job.width
        )  # fmt: skip
        settings = replace(
            run.options.driver, order=wanted_order(self.job, run.options.frames), **self._pools(run.cluster.spec, graph)
        )
        driver = Driver(self.job, graph, self.book, run_node, settings, tell, run.supervisor)
        run.index.look_again()
        reused = driver.reuse(run.index)
        tell({"event": "plan", "stages": stage_counts(graph.nodes), "reused": stage_counts(reused.reused)})
        run.grid.lay_out(graph, reused.reused)
        outcome = reused
        if driver.remaining:
            outcome = driver.run(run.grid.published(run.cluster.client(tell, run.supervisor.check)))
        _merge(result.outcome, outcome)
        for reasons in (outcome.failed, outcome.dead):
            for node_id, reason in reasons.items():
                node = graph.nodes[node_id]
                result.missing |= {(node.stage, frame): reason for frame in node.frames}
                if reasons is outcome.dead:
                    run.supervisor.confirm()
                    self.dead_marks.set(node.stage, node.frames, reason)
        lost = {stage.name for stage, _ in (*outcome.failed, *outcome.dead)}
        found = len(result.missing) > len(known.reasons)  # else the next pass would fail alike
        return bool(found and outcome.blocked and lost - {"preview"})  # a video cannot leave out frames of its own

    def _pools(self, cluster: ClusterSpec, graph: Graph) -> dict[str, Any]:
        """Settings of the driver for a job that has tasks for a GPU."""
        if not cluster.gpu:
            return {}
        stages = frozenset(node.stage.name for node in graph if runs_on_gpu(node))
        return {"gpu_stages": stages, "pools": launcher_of(cluster).pools}

    def _index_records(self, index: RecordIndex) -> None:
        """Brings the record index up to date, so that the next `status` reads no records."""
        index.look_again()
        for node in (node for node in self.graph() if not node.transient):
            for frame in node.frames:
                index.find(node.stage, frame)
        index.save()

    @property
    def dead_marks(self) -> DeadMarks:
        """Marks of frames that are left out."""
        return DeadMarks(self.output.dead)

    def marked_dead(self) -> Marks:
        """Frames that killed their workers in an earlier run, or were skipped; `retry` takes the marks away."""
        return {at: why for at, why in self.dead_marks.read().items() if at[0].name in STAGES}

    @contextmanager
    def _live_grid(self) -> Iterator[LiveGrid]:
        """The state of the run, which the dashboard shows."""
        grid = FrameGrid(self.job.frames, self.job.width * self.job.height / 1e6)
        for (stage, frame), reason in self.marked_dead().items():
            grid.lose(stage.name, frame, DEAD, reason)
        show, how = partial(convert, conversion=self.job.colors.display), Presentation.of(self.job)

        def picture(frame: int) -> bytes:
            return thumbnail(self.output.exr_path(self.job.shot.name, frame), show, how)

        live = LiveGrid(self.job.shot.name, grid, picture)
        try:
            yield live
        finally:
            live.close()


@dataclass(frozen=True)
class _Run:
    """What belongs to one run of a session."""

    options: RunOptions
    result: RunResult
    cluster: LazyCluster
    tell: Listener
    grid: LiveGrid
    supervisor: Supervisor
    index: RecordIndex


def _merge(total: Outcome, one: Outcome) -> None:
    total.done += one.done
    if not total.reused:
        total.reused += one.reused
    total.failed |= one.failed
    total.dead |= one.dead
    total.busy_seconds += one.busy_seconds
    total.kernel_seconds += one.kernel_seconds
