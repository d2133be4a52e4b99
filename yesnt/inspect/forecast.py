"""`yesnt plan`: what a run would do and cost, before anything runs."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from yesnt.core.stage_id import StageId
from yesnt.inspect.fit_forecast import FitForecast
from yesnt.inspect.frame_states import DONE, states
from yesnt.inspect.sampling_cost import SamplingCost, is_indexed, sampling_cost
from yesnt.io import shot_inputs
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.io.record_index import RecordIndex
from yesnt.planning import settings as of
from yesnt.planning.chunks import ROUND
from yesnt.planning.graph import Graph, Node
from yesnt.planning.shot_plan import MATTES, VIEWS, Awaiting
from yesnt.planning.stages import STAGES
from yesnt.planning.task_records import held_frames
from yesnt.runtime.checks.inputs import handles
from yesnt.runtime.clamps import clamp_lines
from yesnt.runtime.session import Session
from yesnt.tasks.light import frame_map

if TYPE_CHECKING:
    from yesnt.relight.scope import Requirement


AWAITING_MATTES = "capture: the stages that read the mattes are planned once these are made; `run` does all"
"""What a plan says of a job whose mattes are still to be made from its capture's pictures."""

AWAITING = "gaussians: the stages that read the rendered pictures are planned once these are made; `run` does all"
"""What a plan says of a job whose plates are still to be made from Gaussian fields."""


@dataclass(frozen=True)
class StageForecast:
    """One row of the plan.

    Attributes:
        stage: its name.
        todo: tasks that would run.
        reuse: tasks whose result is there.
        why: the most frequent reason, with how often.
        seconds: of all tasks that would run, on one worker.
        measured: whether the seconds come from this job's records.
        peak_bytes: predicted resident memory of one worker in this stage.
        disk_bytes: that would be written.
    """

    stage: str
    todo: int
    reuse: int
    why: str
    seconds: float
    measured: bool
    peak_bytes: float
    disk_bytes: float


@dataclass(frozen=True)
class Forecast:
    """The whole plan.

    Attributes:
        stages: rows in order.
        evaluations: sampling cost of the decomposition, in network evaluations.
        chunks: of frames that the shot is solved in; 1: whole.
        halo: frames of halo of the solver's chunks.
        sweeps: exchanges between chunks, at most.
        bands: of rows that a chunk is solved in; 1: whole.
        left_out: what the scene lets the run skip, and why.
        modelled: what relighting computes, and why.
        warnings: odd inputs.
        notes: what the user may want to know of the inputs.
        reads: which channels of the pictures serve what, and how the pixels lie.
    """

    stages: tuple[StageForecast, ...]
    evaluations: SamplingCost
    chunks: int
    halo: int
    sweeps: int
    bands: int
    left_out: tuple[str, ...]
    modelled: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """A plain document."""
        return asdict(self)


def forecast(session: Session) -> Forecast:
    """Checks the inputs and predicts a run; writes only what it learned of the input files (`Session.remember`)."""
    warnings = session.checks.form() + session.checks.content()
    plan, graph, index = session.plan(), session.graph(), session.open_index()
    reasons: dict[str, list[str]] = {stage: [] for stage in STAGES}
    for state in states(session, graph, index):
        if state.state != DONE:
            reasons[StageId.parse(state.stage).name].append(state.why.split(";")[0])
    used, awaiting = {node.stage.name for node in graph}, session.resolved.awaiting
    planned = [name for name, row in STAGES.items() if name in used or not (awaiting or row.in_lanes or row.optional)]
    progress = _Progress(graph, index)
    rows = tuple(_row(session, progress, stage, reasons[stage]) for stage in planned)
    unbaked = session.job.shot.light.set and not session.output.baked_light.exists()
    terms = () if awaiting or unbaked else _relight_terms(session)
    modelled = tuple(f"{term.term}: {term.reason}" for term in terms if term.modelled)
    spent = sampling_cost(session, graph, index)
    warnings += clamp_lines(session.job.frames, graph, index)
    session.remember()
    index.save()
    chunks, left_out = plan.chunks, tuple(_left_out(session, terms))
    cut = len(plan.exchange.blocks), chunks.halo, plan.exchange.sweeps, len(chunks.bands)
    notes = (*session.checks.notes, *handles(session.job), *_told_later(awaiting))
    told = notes, tuple(session.checks.reads())
    return Forecast(rows, spent, *cut, left_out, modelled, tuple(warnings), *told)


def _told_later(awaiting: Awaiting) -> tuple[str, ...]:
    return {MATTES: (AWAITING_MATTES,), VIEWS: (AWAITING,)}.get(awaiting, ())


class _Progress:
    """Nodes by stage, and which of them are done."""

    def __init__(self, graph: Graph, index: RecordIndex) -> None:
        self.index = index
        self._by_stage: dict[str, list[Node]] = {}
        for node in graph:
            if not node.transient or STAGES[node.stage.name].in_lanes:
                self._by_stage.setdefault(node.stage.name, []).append(node)

    def nodes(self, stage: str) -> list[Node]:
        """The stage's nodes that are counted: windows, and what is kept."""
        return self._by_stage.get(stage, [])

    def todo(self, stage: str) -> list[Node]:
        """Those that would run; windows only for frames that are not decomposed."""
        if STAGES[stage].in_lanes and not self.todo("decompose"):
            return []
        return [node for node in self.nodes(stage) if not is_indexed(self.index, node)]


def _row(session: Session, progress: _Progress, stage: str, reasons: list[str]) -> StageForecast:
    nodes, todo = progress.nodes(stage), progress.todo(stage)
    row, pixels = STAGES[stage], session.job.width * session.job.height
    measured = _measured_seconds(progress.index, nodes)
    cost = row.cost
    model = cost.seconds + cost.seconds_per_megapixel * pixels * _held(nodes) / 1e6
    sweeps = _solves(session) if stage == "solve" else 1
    peak = cost.megabytes * 1e6 + cost.bytes_per_pixel * pixels * (1 if row.streams else _held(nodes))
    seconds, known = len(todo) * sweeps * (measured if measured is not None else model), measured is not None
    if stage == "fit":
        fits = FitForecast(session)
        (seconds, known), peak = fits.seconds(todo, nodes, progress.index), fits.peak_bytes(nodes)
    return StageForecast(
        stage,
        len(todo),
        len(nodes) - len(todo),
        _most_frequent(reasons),
        seconds,
        known,
        session.chunks.peak_bytes if stage == "solve" else peak,
        sum(len(node.frames) for node in todo) * pixels * cost.disk_bytes_per_pixel,
    )


def _solves(session: Session) -> float:
    """How often a chunk's pixels are solved: about once a round, warm, and more than once where bands overlap."""
    chunks, height = session.chunks, session.job.height
    rows = sum(min(height, len(band.outer) + 2 * chunks.reach) for band in chunks.bands)
    return (1 + session.plan().exchange.sweeps / ROUND) * rows / height


def _held(nodes: list[Node]) -> int:
    """Frames that the largest task of a stage holds in memory."""
    return max((held_frames(node.task, node.frames) for node in nodes), default=1)


def _measured_seconds(index: RecordIndex, nodes: list[Node]) -> float | None:
    """Median seconds of a task in this job's records."""
    entries = [index.find(node.stage, node.frames[0]) for node in nodes]
    seconds = [entry.seconds for entry in entries if entry is not None]
    return statistics.median(seconds) if seconds else None


def _most_frequent(reasons: list[str]) -> str:
    if not reasons:
        return ""
    reason, count = Counter(reasons).most_common(1)[0]
    return f"{reason} ({count} of {len(reasons)} frames)"


def _left_out(session: Session, terms: Iterable[Requirement]) -> list[str]:
    """Terms and stages that this job does not need, with reasons."""
    shot = session.job.shot
    found = [f"{term.term}: {term.reason}" for term in terms if not term.modelled]
    if not shot.decompose.samples_backend:
        found.append("diffusion: the job brings its own passes")
    if shot.flow.path is not None:
        found.append("optical flow: the job brings its own")
    if session.plan().exchange.sweeps == 0:
        found.append("exchange between chunks: the shot fits into one")
    if shot.background is None and shot.set is None:
        found.append("background plate: the light's map is seen instead")
    return found


def _relight_terms(session: Session) -> tuple[Requirement, ...]:
    """The terms of relighting that this shot's maps and proxy need."""
    from yesnt.relight import prepare_capture, prepare_relight
    from yesnt.relight.scope import SceneFacts, requirements

    shot, settings = session.job.shot, of.relight_settings(session.job.shot)
    first = session.job.frames[0]
    light = prepare_relight(frame_map(session.job, shot.light, first), settings)
    captured = prepare_capture(frame_map(session.job, shot.capture_light, first), settings)
    ranges = session.checks.material_ranges() or (None, None)
    known = (shot.proxy is not None, *ranges, _short_normals(session))
    return requirements(SceneFacts(light, captured, *known), settings)


def _short_normals(session: Session) -> float:
    """Share of the first frame's normals that are averages of several directions."""
    from yesnt.relight.pixel_filter import short_normals

    job, first = session.job, session.job.frames[0]
    camera = shot_camera(job)
    return short_normals(shot_inputs.read_surface(job, first, camera).normal, shot_inputs.read_matte(job, first) > 0)
