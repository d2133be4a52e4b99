"""Arguments of tasks: one frozen record for each kind of task. The stage table maps each to the function that runs it.

Records are small: they are sent to workers. Frames are given by number, places in the shot by position.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from yesnt.core.blocks import Block, Span
from yesnt.core.stage_id import StageId
from yesnt.planning.exchange import Exchange

if TYPE_CHECKING:
    from yesnt.capture_stage.jobs import RenderJob


@dataclass(frozen=True)
class TaskRecord:
    """Base of all records."""


@dataclass(frozen=True)
class Gaps:
    """Frames that the solver does without.

    Attributes:
        absent: frames without a decomposition; their confidence is 0.
        unlinked: frames without flow to the next.
    """

    absent: frozenset[int] = frozenset()
    unlinked: frozenset[int] = frozenset()

    def among(self, frames: Iterable[int]) -> Gaps:
        """The gaps among these frames."""
        if not (self.absent or self.unlinked):
            return self
        held = frozenset(frames)
        return Gaps(self.absent & held, self.unlinked & held)


@dataclass(frozen=True)
class BackgroundTask(TaskRecord):
    """Finds what one camera of the capture shows without the subject.

    Attributes:
        camera: its name.
    """

    camera: str


@dataclass(frozen=True)
class MatteTask(TaskRecord):
    """Makes the mattes of all cameras of the capture in one frame.

    Attributes:
        cameras: their names.
    """

    cameras: tuple[str, ...]


@dataclass(frozen=True)
class FitTask(TaskRecord):
    """Fits the Gaussian field of one frame to the pictures of the capture.

    Attributes:
        cameras: names of those that are fitted.
        held_out: names of those that only measure.
        keyframe: frame whose field the fit starts from; None: it starts from the visual hull.
    """

    cameras: tuple[str, ...]
    held_out: tuple[str, ...]
    keyframe: int | None = None


@dataclass(frozen=True)
class MeshTask(TaskRecord):
    """Extracts the proxy mesh of one frame's Gaussian field."""


@dataclass(frozen=True)
class ViewTask(TaskRecord):
    """Renders one frame's Gaussian field for the shot's camera."""


@dataclass(frozen=True)
class WindowTask(TaskRecord):
    """Samples the materials of all frames of a node together (video backends).

    Attributes:
        weights: digest of the backend's weights.
    """

    weights: str


@dataclass(frozen=True)
class ReadPassesTask(TaskRecord):
    """Reads the materials of one frame from the passes that the job brings."""


@dataclass(frozen=True)
class DecomposeTask(TaskRecord):
    """Samples the materials of one frame.

    Attributes:
        weights: digest of the backend's weights.
        keyframe: frame whose estimate is carried along the flow first; None: the frame is sampled in full.
    """

    weights: str
    keyframe: int | None = None


@dataclass(frozen=True)
class BlendWindowsTask(TaskRecord):
    """Blends the windows that cover one frame.

    Attributes:
        weights: weight of each covering window, by the stage that stores it; they sum to 1.
        nfe: network evaluations of one member of a window, per frame.
    """

    weights: Mapping[StageId, float]
    nfe: float


@dataclass(frozen=True)
class FlowTask(TaskRecord):
    """Optical flow of one frame to the next."""


@dataclass(frozen=True)
class CorrectTask(TaskRecord):
    """Corrects the observed materials of one frame by the job's passes of one quantity and overrides."""


@dataclass(frozen=True)
class MeasureTask(TaskRecord):
    """Measures the materials of one frame by the capture's cameras.

    Attributes:
        cameras: names of those that are used; none: the model's estimate stands.
    """

    cameras: tuple[str, ...]


@dataclass(frozen=True)
class TrackTask(TaskRecord):
    """Measures the materials of one frame by other frames of the same camera.

    Attributes:
        moments: those frames; none: the model's estimate stands.
    """

    moments: tuple[int, ...]


@dataclass(frozen=True)
class CarryEvidenceTask(TaskRecord):
    """Takes the measured materials of a later frame along the flow.

    Attributes:
        keyframe: that frame.
    """

    keyframe: int


@dataclass(frozen=True)
class ConfidenceTask(TaskRecord):
    """Data weights of the frames of a node.

    Attributes:
        loaded: positions that are read: the node's frames and a halo.
        gaps: among the loaded frames.
    """

    loaded: Span
    gaps: Gaps


@dataclass(frozen=True)
class SolveTask(TaskRecord):
    """Base of the temporal solver's tasks.

    Attributes:
        exchange: the schedule of the shot; where each block's last value is stored follows from it.
        sweep: sweep of this task.
        gaps: among the loaded frames.
    """

    exchange: Exchange
    sweep: int
    gaps: Gaps

    @property
    def bands(self) -> tuple[Block, ...]:
        """All bands of rows."""
        return self.exchange.chunks.bands


@dataclass(frozen=True)
class SolveBlockTask(SolveTask):
    """Solves one band of one chunk.

    Attributes:
        chunk: number of the chunk.
        band: number of the band.
    """

    chunk: int
    band: int


@dataclass(frozen=True)
class SolveJointlyTask(SolveTask):
    """Solves the unconverged pixels of all frames together."""


@dataclass(frozen=True)
class JoinBandsTask(SolveTask):
    """Puts the bands of one chunk together to whole frames."""


@dataclass(frozen=True)
class GroundTask(TaskRecord):
    """Finds where the subject stands, from the proxies of all frames of the shot.

    Attributes:
        frames: of the shot, in order.
    """

    frames: tuple[int, ...]


@dataclass(frozen=True)
class RelightTask(TaskRecord):
    """Relights one frame.

    Attributes:
        base_from_views: whether the capture's cameras tell of the base colour too.
    """

    base_from_views: bool = False


@dataclass(frozen=True)
class SidesTask(TaskRecord):
    """Shows sides of the subject that the delivered view does not.

    Attributes:
        cameras: of the capture, which measure these sides; none: they take the materials of sides that are seen.
    """

    cameras: tuple[str, ...]


@dataclass(frozen=True)
class SetTask(SidesTask):
    """Lights the set in one frame."""


@dataclass(frozen=True)
class BakeTask(TaskRecord):
    """Bakes the environment map at the actor's place from the scene.

    Attributes:
        frames: whose proxies tell where the actor is.
    """

    frames: tuple[int, ...]


@dataclass(frozen=True)
class SceneTask(SidesTask):
    """Renders the scene of one frame with and without the subject."""


@dataclass(frozen=True)
class CompositeTask(TaskRecord):
    """Writes the EXR of one frame.

    Attributes:
        job_digest: of the job's settings, for the file's header.
    """

    job_digest: str


@dataclass(frozen=True)
class CompositingTask(TaskRecord):
    """Writes the scripts that put the layers together again in other programs."""


@dataclass(frozen=True)
class PreviewSegmentTask(TaskRecord):
    """Encodes a segment of the preview video.

    Attributes:
        frames: of the segment, in order.
    """

    frames: tuple[int, ...]


@dataclass(frozen=True)
class PreviewTask(TaskRecord):
    """Joins the segments to the preview video and the contact sheet.

    Attributes:
        segments: their number.
    """

    segments: int


@dataclass(frozen=True)
class RenderTask(TaskRecord):
    """Renders one job of the virtual capture stage."""

    job: RenderJob


def held_frames(task: TaskRecord, frames: tuple[int, ...]) -> int:
    """Frames that a task loads, for predictions of its memory and time; `frames` are those that it commits."""
    if isinstance(task, ConfidenceTask):
        return len(task.loaded)
    if isinstance(task, SolveBlockTask):
        return len(task.exchange.loaded(task.exchange.blocks[task.chunk], task.sweep))
    if isinstance(task, TrackTask):
        return 1 + len(task.moments)
    return len(frames) if isinstance(task, WindowTask | SolveJointlyTask | JoinBandsTask) else 1
