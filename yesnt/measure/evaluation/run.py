"""Runs an evaluation: all shots of a set are processed and scored, then one document is written."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from yesnt.core.capture_input import EvidenceInput
from yesnt.core.errors import JobError, UsageError
from yesnt.core.frame_ranges import frame_ranges
from yesnt.core.shot import Job, Shot
from yesnt.io.durable import sweep_partials, write_bytes, write_json
from yesnt.io.jobfile import load_shot, parse_frames
from yesnt.io.store import FrameStore
from yesnt.measure.evaluation.constants import best_constants
from yesnt.measure.evaluation.measured_jobs import fitted_session, measured_sessions, open_session
from yesnt.measure.evaluation.page import write_page
from yesnt.measure.evaluation.plan import EvalPlan
from yesnt.measure.evaluation.subjects import Subject, common_frames, find_subjects
from yesnt.measure.evaluation.summary import summarise
from yesnt.measure.evaluation.table import as_markdown
from yesnt.measure.evaluation.tasks import run_evaluation_node
from yesnt.planning.graph import Graph, NodeId
from yesnt.runtime.cluster.open_cluster import open_cluster
from yesnt.runtime.cluster.precompile import Precompilation
from yesnt.runtime.driver.driver import Driver
from yesnt.runtime.launchers.spec import read_cluster
from yesnt.runtime.launchers.table import check_cluster
from yesnt.runtime.session import Session
from yesnt.workflows.evaluate import (
    ablation_graph,
    constants_graph,
    evaluation_graph,
    fitted_graph,
    materials_graph,
    measured_graph,
)

Listener = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True)
class EvalOptions:
    """Options of an evaluation.

    Attributes:
        shots: names of the shots to evaluate; None: all that have truth.
        maps: names of the maps to evaluate; None: all that have truth.
        capture_rows: names of the rows that shots with a capture get; None: all that it has the cameras for.
        thorough: largest number of frames per shot on which every row is scored.
        probes: largest number of maps per shot for the term-by-term rows and the search of constants.
        chosen: frames on which every row is scored instead, as "1003,1012"; None: as `thorough` says.
        samples: members of the ensemble; None: as the shots say.
        weights: of the decomposition; None: as the shots say.
        quality: of the relighting; None: as the shots say.
        lpips: a state_dict of LPIPS with AlexNet, for the columns that need one.
        fit_knobs: knobs of the Gaussian field that is fitted to every shot's capture; None: none is fitted.
        workers: worker processes; 0: everything in this process; None: the cluster profile's, or 2.
        cluster: where tasks run.
    """

    shots: tuple[str, ...] | None = None
    maps: tuple[str, ...] | None = None
    capture_rows: tuple[str, ...] | None = None
    thorough: int = 3
    probes: int = 3
    chosen: str | None = None
    samples: int | None = None
    weights: Path | None = None
    quality: str | None = None
    lpips: Path | None = None
    fit_knobs: Mapping[str, Any] | None = None
    workers: int | None = None
    cluster: str = "local"


@dataclass
class EvalResult:
    """Result of an evaluation: the document, its files, and the reasons of failures by shot and node."""

    document: dict[str, Any]
    output: Path
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def json(self) -> Path:
        """The document."""
        return self.output / "evaluation.json"

    @property
    def markdown(self) -> Path:
        """The tables."""
        return self.output / "evaluation.md"

    @property
    def page(self) -> Path:
        """The tables and the pictures."""
        return self.output / "evaluation.html"


def run_evaluation(
    folder: Path, output: Path, options: EvalOptions, listen: Listener = lambda event: None
) -> EvalResult:
    """Evaluates every shot with ground truth below a folder; finished work is kept.

    Args:
        folder: a shot, or a folder of shots.
        output: where stores, records, pictures and tables go.
        options: shots, maps and settings.
        listen: receives every event of the driver.

    Raises:
        UsageError: there is nothing to evaluate.
        JobError: an input is wrong.
    """
    started = time.time()
    plans = [open_plan(subject, output, options) for subject in find_subjects(folder, options.maps, options.shots)]
    with ExitStack() as stack:
        drive = _Drive(options, listen, stack)
        for plan in plans:
            drive(plan, evaluation_graph(plan))
        constants = best_constants(plans)
        for plan in plans:
            drive(plan, constants_graph(plan, constants[plan.subject.name]))
        for plan in plans:
            drive_measured(plan, drive)
        for plan in plans:
            drive_fitted(plan, drive)
        for plan in plans:
            drive(plan, ablation_graph(plan))
    document = summarise(plans, constants)
    document |= measured_elsewhere(output)
    day = datetime.now(UTC).date().isoformat()
    document |= {"folder": str(folder), "date": day, "seconds": time.time() - started}
    result = EvalResult(document, output, drive.failed)
    write_json(result.json, document)
    write_bytes(result.markdown, as_markdown(document).encode())
    write_page(result.page, document, output)
    return result


def drive_measured(plan: EvalPlan, drive: _Drive) -> None:
    """Measures the materials of a shot by its capture, job by job, and scores them."""
    for session in plan.measured.values():
        drive.product(session, plan.subject.name)
    if plan.measured:
        drive(plan, measured_graph(plan))


def drive_fitted(plan: EvalPlan, drive: _Drive) -> None:
    """Fits a field to the capture of a shot, takes plate, G-buffer and proxy from it, and scores what comes of them."""
    if plan.fitted is None:
        return
    if plan.fitted.resolved.awaiting:
        drive.made(plan.fitted, plan.subject.name)
        plan.fitted.look_again()
    if not plan.fitted.resolved.awaiting:
        drive.product(plan.fitted, plan.subject.name)
        drive(plan, fitted_graph(plan))


def measured_elsewhere(output: Path) -> dict[str, Any]:
    """Results of other commands in folders next to this one: `unmodelled/evaluation.json`, `scaling/scaling.json`."""
    unmodelled, scaling = output.parent / "unmodelled" / "evaluation.json", output.parent / "scaling" / "scaling.json"
    found: dict[str, Any] = {}
    if unmodelled.is_file():
        found["unmodelled"] = json.loads(unmodelled.read_text())["unmodelled"]
    if scaling.is_file():
        found["scaling"] = json.loads(scaling.read_text())
    return found


def open_plan(subject: Subject, output: Path, options: EvalOptions) -> EvalPlan:
    """Writes the job file of a shot's evaluation and opens it.

    The shot's own folder is only read: the job file in the evaluation's folder names its inputs by absolute paths.
    """
    shot = load_shot(subject.folder / "shot.yaml")
    home = output / "shots" / subject.name
    home.mkdir(parents=True, exist_ok=True)
    lacking = ""
    try:
        session = open_session(home, _absolute(shot, subject, options))
    except JobError as error:
        if not shot.decompose.samples_backend or "weights" not in error.what:
            raise
        lacking = f"no decomposition: {error.what[0].lower()}{error.what[1:]}"
        true = _absolute(shot, subject, options)
        true["decompose"] = {"path": str(subject.folder / "truth" / "material.####.exr")}
        session = open_session(home, true)
    chosen = () if options.chosen is None else parse_frames(options.chosen, "--at")
    plan = EvalPlan(subject, session, lacking, options.thorough, options.probes, chosen, options.lpips)
    check_scored(plan)
    if lacking:
        return plan
    with_capture = partial(_absolute, subject=subject, options=options, measured=True)
    knobs = options.fit_knobs
    fitted = None if knobs is None else fitted_session(subject, home, with_capture, knobs)
    return replace(plan, measured=measured_sessions(subject, home, with_capture, options.capture_rows), fitted=fitted)


def check_scored(plan: EvalPlan) -> None:
    """Refuses chosen frames of which a map has none.

    Raises:
        UsageError: a map of the shot has truth at none of the frames on which rows are to be scored.
    """
    for name, _ in plan.subject.maps:
        if not plan.scored_frames(name):
            there = common_frames(plan.subject, name, plan.frames)
            raise UsageError(
                f"The shot {plan.subject.name} has no truth under {name} at these frames", "--at",
                frame_ranges(there), "name some of these",
            )  # fmt: skip


def _absolute(shot: Shot, subject: Subject, options: EvalOptions, measured: bool = False) -> dict[str, Any]:
    """The shot as a document whose paths are absolute and whose output is the evaluation's.

    `measured` keeps the capture, which is left out otherwise: Full is what the plate alone gives.
    """
    changes: dict[str, Any] = {"output": "out", "camera": str(subject.folder / shot.camera)}
    if shot.capture is not None:
        kept = {name: str(subject.folder / path) for name, path in shot.capture.paths.items()}
        changes["capture"] = shot.capture.model_copy(update=kept) if measured else None
        changes |= {} if measured else {"evidence": EvidenceInput()}
    for name in ("plate", "matte", "gbuffer", "light", "capture_light", "background", "proxy", "decompose", "flow"):
        part = getattr(shot, name)
        if part is not None and part.path is not None:
            changes[name] = part.model_copy(update={"path": str(subject.folder / part.path)})
    shot = shot.model_copy(update=changes)
    asked = {
        "samples": options.samples,
        "weights": None if options.weights is None else str(options.weights.absolute()),
    }
    decompose = shot.decompose.model_copy(update={k: v for k, v in asked.items() if v is not None})
    quality = {} if options.quality is None else {"quality": options.quality}
    return shot.model_copy(update={"decompose": decompose, **quality}).model_dump(mode="json", exclude_none=True)


class _Drive:
    """Runs graphs, in this process or on a cluster that is started when the first task needs it."""

    def __init__(self, options: EvalOptions, listen: Listener, stack: ExitStack) -> None:
        self._options, self._listen, self._stack = options, listen, stack
        self._spec = read_cluster(options.cluster, options.workers or None)
        check_cluster(self._spec)
        self._client: Any = None
        self.failed: dict[str, str] = {}

    def __call__(self, plan: EvalPlan, graph: Graph) -> None:
        """Runs what has no record yet."""
        self._run(plan.session, graph, plan.subject.name, plan.arrays())

    def product(self, session: Session, name: str) -> None:
        """Runs a job up to its materials."""
        self._run(session, materials_graph(session), name, {})

    def made(self, session: Session, name: str) -> None:
        """Runs what a job makes from Gaussian fields before it can read it."""
        self._run(session, session.graph(), name, {})

    def _run(self, session: Session, graph: Graph, name: str, more: Mapping[str, str]) -> None:
        """Runs the nodes of a job that have no record; `more` are arrays that only the evaluation writes."""
        job = session.job
        with session.output.lock():
            sweep_partials(session.output.root)
            arrays = session.plan().arrays() | dict(more)
            FrameStore.create(session.output.store, arrays, job.frames, job.height, job.width)
            driver = Driver(job, graph, session.book, run_evaluation_node, None, self._listen)
            reused = driver.reuse()
            counts = _count(list(graph.nodes)), _count(reused.reused)
            self._listen({"event": "plan", "stages": counts[0], "reused": counts[1], "shot": name})
            if not driver.remaining:
                return
            if self._options.workers == 0:
                _run_here(job, graph, set(reused.reused), self._listen)
                return
            outcome = driver.run(self._cluster(session.output.run))
        for node_id, reason in (outcome.failed | outcome.dead).items():
            self.failed[f"{name}: {node_id[0]} {node_id[1]}"] = reason

    def _cluster(self, folder: Path) -> Any:
        """The client; a cluster that is started keeps its certificates and logs in the folder."""
        if self._client is None:
            if self._spec.kind == "local":
                with closing(Precompilation()) as compilation:
                    compilation.wait(self._listen)
            self._client = self._stack.enter_context(open_cluster(self._spec.of_job(False, folder)))
            self._listen({"event": "cluster", "dashboard": self._client.dashboard_link or ""})
        return self._client


def _run_here(job: Job, graph: Graph, done: set[Any], listen: Listener) -> None:
    """Runs nodes one after another in this process; the first error ends it."""
    for node in graph:
        if node.id in done:
            continue
        about = {"time": time.time(), "stage": node.stage.label, "frames": list(node.frames)}
        listen({"event": "start", **about})
        receipt = run_evaluation_node(job, node)
        listen({"event": "done", **about, **receipt})


def _count(ids: Iterable[NodeId]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for stage, _ in ids:
        counts[stage.name] = counts.get(stage.name, 0) + 1
    return counts
