"""The stage table: one row for each stage, with all that other modules must know of it.

To add a stage, add a row here, its task records (`task_records.py`), a builder of its nodes (`builders/`), the
functions that run them (`yesnt/tasks/`), and a line in `workflows/shot.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from yesnt.core.stage_id import StageId
from yesnt.planning import task_records as records


@dataclass(frozen=True)
class Cost:
    """A linear model of a task, measured on one core of a 2.6 GHz server processor.

    First guesses for `yesnt plan`; as soon as a job has records, its own median seconds are used instead.

    Attributes:
        seconds: of a task of no pixels.
        seconds_per_megapixel: per million pixels of frame area and frame held.
        megabytes: resident memory of a worker that has loaded what the stage needs.
        bytes_per_pixel: of frame area and frame held.
        disk_bytes_per_pixel: of frame area and frame written, compressed.
        scheduler_seconds: what Dask's scheduler assumes of a task before it has measured one; None: Dask's default.
    """

    seconds: float
    seconds_per_megapixel: float
    megabytes: float
    bytes_per_pixel: float
    disk_bytes_per_pixel: float
    scheduler_seconds: int | None = None


@dataclass(frozen=True)
class Stage:
    """A row of the table.

    Attributes:
        name: the word in keys, records, logs, dashboard.
        version: of its code; raised when its result or a default changes, which makes every older record stale.
        holds: what one task holds in memory.
        reads: in words.
        channels: channels of the frame store that it writes.
        files: other files that it writes, in words.
        cost: model of a task's time, memory and disk.
        color: in plots, as CSS.
        tasks: the function that runs each kind of task record, as `module:function`.
        in_lanes: its arrays are stored per lane of windows (`StageId.lane`) and removed once they are blended.
        optional: it runs only for jobs that ask for it, and has arrays only there.
        streams: its tasks read frame by frame, so that their memory does not grow with the frames they load.
        former_name: folder of its records in outputs of older versions.
    """

    name: str
    version: int
    holds: str
    reads: str
    cost: Cost
    color: str
    tasks: Mapping[type[records.TaskRecord], str]
    channels: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    in_lanes: bool = False
    optional: bool = False
    streams: bool = False
    former_name: str = ""

    @property
    def writes(self) -> tuple[str, ...]:
        """Channels and other files, in words."""
        return self.channels + self.files


_ROWS = (
    Stage(
        "matte", 2, "frame; a camera's background", "pictures of the capture's cameras and their clean plates (only "
        "jobs with `capture.matting`)",
        Cost(10.0, 0.0, 900, 0, 2), "#3f6f6a",
        {
            records.BackgroundTask: "yesnt.tasks.matte:find_background",
            records.MatteTask: "yesnt.tasks.matte:make_mattes",
        },
        files=("mattes (PNG)", "backgrounds (EXR)"), optional=True,
    ),
    Stage(
        "fit", 4, "frame", "pictures of the capture's cameras; between keyframes also a keyframe's field (only jobs "
        "that fit Gaussians)",
        Cost(200.0, 0.0, 900, 0, 0), "#5b4a2f",
        {records.FitTask: "yesnt.tasks.fit:fit_field"},
        files=("Gaussian field (PLY)",), optional=True,
    ),
    Stage(
        "mesh", 2, "frame", "Gaussian field, cameras of the capture (only jobs with Gaussians and no proxy)",
        Cost(30.0, 0.0, 900, 0, 10), "#8c6d31",
        {records.MeshTask: "yesnt.tasks.gaussians:extract_proxy"},
        files=("proxy mesh (PLY, GLB)",), optional=True,
    ),
    Stage(
        "view", 3, "frame", "Gaussian field, camera (only jobs with Gaussians and no plate or G-buffer)",
        Cost(0.5, 2.0, 500, 200, 20), "#c7a252",
        {records.ViewTask: "yesnt.tasks.gaussians:render_view"},
        files=("plate and G-buffer (EXR)",), optional=True,
    ),
    Stage(
        "window", 2, "window of frames (video backends)", "plates",
        Cost(60.0, 2000.0, 4000, 60, 4), "#2f4b7c",
        {records.WindowTask: "yesnt.tasks.decompose:sample_window"},
        channels=("observed", "spread"), in_lanes=True,
    ),
    Stage(
        "decompose", 5, "frame", "plate; between keyframes also a keyframe and the flow to it; or its windows",
        Cost(0.3, 25.0, 550, 300, 4, scheduler_seconds=5), "#4878a8",
        {
            records.ReadPassesTask: "yesnt.tasks.decompose:read_passes",
            records.DecomposeTask: "yesnt.tasks.decompose:sample_frame",
            records.BlendWindowsTask: "yesnt.tasks.decompose:blend_windows",
        },
        channels=("observed", "spread", "nfe"),
    ),
    Stage(
        "flow", 3, "frame and the next", "two plates",
        Cost(0.05, 2.0, 350, 150, 4, scheduler_seconds=1), "#8cb369",
        {records.FlowTask: "yesnt.tasks.flow:estimate_flow"},
        channels=("flow", "validity"),
    ),
    Stage(
        "evidence", 12, "frame", "observed, spread, plate, G-buffer, proxy, pictures of the capture's cameras; or "
        "a measured frame and the flow to it; or the frames around it (only jobs with a capture or `evidence.time`)",
        Cost(1.0, 40.0, 600, 600, 5), "#5aa7a7",
        {
            records.MeasureTask: "yesnt.tasks.evidence:measure_materials",
            records.TrackTask: "yesnt.tasks.evidence_tracks:measure_tracks",
            records.CarryEvidenceTask: "yesnt.tasks.evidence:carry_materials",
        },
        channels=("measured", "measured_spread", "views", "base_views"), optional=True,
    ),
    Stage(
        "correct", 1, "frame", "observed, spread, plate, masks and passes of one quantity (only jobs that correct)",
        Cost(0.05, 1.0, 400, 120, 3), "#7f7f4f",
        {records.CorrectTask: "yesnt.tasks.correct:correct_materials"},
        channels=("corrected", "corrected_spread", "certain"), optional=True,
    ),
    Stage(
        "confidence", 4, "chunk with halo", "observed, spread, flow, validity",
        Cost(0.2, 0.5, 400, 160, 2), "#b07aa1",
        {records.ConfidenceTask: "yesnt.tasks.confidence:weigh_frames"},
        channels=("confidence",), streams=True, former_name="trust",
    ),
    Stage(
        "solve", 6, "shot; if long, chunk with halo; bands of rows", "observed, confidence, flow, validity",
        Cost(0.5, 4.0, 400, 160, 2, scheduler_seconds=5), "#d1495b",
        {
            records.SolveBlockTask: "yesnt.tasks.solve:solve_block",
            records.SolveJointlyTask: "yesnt.tasks.solve_jointly:solve_jointly",
            records.JoinBandsTask: "yesnt.tasks.join_bands:join_bands",
        },
        channels=("material",),
    ),
    Stage(
        "ground", 1, "shot", "proxies (only jobs with a set)",
        Cost(1.0, 0.0, 400, 0, 0), "#8a6d3b",
        {records.GroundTask: "yesnt.tasks.ground:find_ground"},
        files=("height of the ground",), optional=True,
    ),
    Stage(
        "bake", 1, "shot", "scene, proxies of three frames (only jobs with `light: set`)",
        Cost(30.0, 0.0, 1500, 0, 0, scheduler_seconds=30), "#c9a66b",
        {records.BakeTask: "yesnt.tasks.scene:bake_light"},
        files=("environment map",), optional=True,
    ),
    Stage(
        "relight", 10, "frame", "plate, G-buffer, proxy, material, light; the ground and the set's mesh",
        Cost(0.2, 12.0, 500, 400, 8, scheduler_seconds=5), "#edae49",
        {records.RelightTask: "yesnt.tasks.relight:relight"},
        channels=("base_color", "diffuse", "specular", "shadow", "sun_diffuse", "sun_specular"),
    ),
    Stage(
        "set", 5, "frame", "base_color, diffuse, material, matte, G-buffer, proxy, light, ground or scene "
        "(only jobs with a set)",
        Cost(0.2, 12.0, 500, 600, 8), "#c58b5b",
        {
            records.SetTask: "yesnt.tasks.set_stage:light_the_set",
            records.SceneTask: "yesnt.tasks.scene:render_scene",
        },
        channels=("set_open", "set_ratio", "set_added", "set_sun", "holdout", "front"), optional=True,
    ),
    Stage(
        "composite", 3, "frame", "diffuse, specular, background or what the set shows",
        Cost(0.05, 1.5, 400, 250, 18), "#66a182",
        {
            records.CompositeTask: "yesnt.tasks.composite:composite",
            records.CompositingTask: "yesnt.tasks.compositing:write_scripts",
        },
        files=("EXR sequence", "scripts for Nuke and Blender"),
    ),
    Stage(
        "preview", 5, "second of the video; then the shot", "the EXR sequence",
        Cost(0.2, 0.3, 400, 40, 0.5), "#999999",
        {
            records.PreviewSegmentTask: "yesnt.tasks.preview:encode_segment",
            records.PreviewTask: "yesnt.tasks.preview:join_preview",
        },
        files=("preview video", "contact sheet"),
    ),
)  # fmt: skip

STAGES = {row.name: row for row in _ROWS}
"""Every stage by name, in order."""

FORMER_ARRAYS = ("evaluations",)
"""Arrays of the store in outputs of older versions; a run removes them."""

(
    MATTE, FIT, MESH, VIEW, WINDOW, DECOMPOSE, FLOW, EVIDENCE, CORRECT, CONFIDENCE, SOLVE, GROUND, BAKE, RELIGHT, SET,
    COMPOSITE, PREVIEW,
) = map(StageId, STAGES)  # fmt: skip

COMPOSITING = StageId("composite", part="scripts")
"""Scripts for other programs beside the EXR sequence, of jobs with a set or both light groups."""

SEGMENT = StageId("preview", part="segment")
"""Segments of the preview video."""


def background_stage(number: int) -> StageId:
    """The background of a camera, by its number among those of the capture."""
    return StageId("matte", part=f"background{number}")


def stage_of(stage: StageId) -> Stage:
    """The row of a stage."""
    return STAGES[stage.name]


def find_stage(name: str) -> Stage | None:
    """The row of a name that was read from a file, also of a stage's former name; None for any other."""
    return STAGES.get(name) or next((row for row in STAGES.values() if name and name == row.former_name), None)


def function_of(stage: StageId, task: records.TaskRecord) -> str:
    """The function that runs a task, as `module:function`.

    Raises:
        KeyError: the stage has no such kind of task.
    """
    return stage_of(stage).tasks[type(task)]
