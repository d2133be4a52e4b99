"""Arguments of the evaluation's tasks: one frozen record for each kind of task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yesnt.core.shot import Job
from yesnt.measure.evaluation.subjects import Subject
from yesnt.planning.task_records import TaskRecord


@dataclass(frozen=True)
class SubjectTask(TaskRecord):
    """Base of all records.

    Attributes:
        subject: the shot and its truth.
    """

    subject: Subject


@dataclass(frozen=True)
class TrueSolveTask(SubjectTask):
    """Solves the true materials.

    Attributes:
        own: whether the product's own confidence is known.
        arrays: which solves are made.
    """

    own: bool
    arrays: tuple[str, ...]


@dataclass(frozen=True)
class MaterialTask(SubjectTask):
    """Measures materials and flow against the truth."""


@dataclass(frozen=True)
class MapTask(SubjectTask):
    """Base of the tasks that look at one light map.

    Attributes:
        map: its name.
    """

    map: str


@dataclass(frozen=True)
class VideoTask(MapTask):
    """Measures the videos of a map."""


@dataclass(frozen=True)
class SearchTask(MapTask):
    """Searches the best constant material of one frame.

    Attributes:
        knobs: of the cheap relighting that is searched with.
        shot: digest of the shot's files; keys the scene that a worker keeps.
    """

    knobs: Mapping[str, Any]
    shot: str


@dataclass(frozen=True)
class BouncesTask(MapTask):
    """Measures the contribution of further bounces.

    Attributes:
        shot: as in `SearchTask`.
    """

    shot: str


@dataclass(frozen=True)
class MeasuredMaterialTask(SubjectTask):
    """Measures materials that a capture measured.

    Attributes:
        jobs: row -> the job whose output holds its materials.
    """

    jobs: Mapping[str, Job]


@dataclass(frozen=True)
class MeasuredScoreTask(MapTask):
    """Scores rows whose materials a capture measured.

    Attributes:
        shot: as in `SearchTask`.
        jobs: as in `MeasuredMaterialTask`.
        base_from_views: rows whose base colour the capture's cameras tell too.
        strip: the row whose picture is written for the page; "": none.
    """

    shot: str
    jobs: Mapping[str, Job]
    base_from_views: tuple[str, ...]
    strip: str


@dataclass(frozen=True)
class MeasuredVideoTask(MapTask):
    """Measures the video of a row whose materials a capture measured.

    Attributes:
        row: its name.
        shots: frame -> as in `SearchTask`.
        measured: the job whose output holds the materials.
        base_from_views: whether the capture's cameras tell of the base colour too.
    """

    row: str
    shots: Mapping[int, str]
    measured: Job
    base_from_views: bool


@dataclass(frozen=True)
class FittedScoreTask(MapTask):
    """Scores a shot whose plate, G-buffer and proxy come from a fitted field.

    Attributes:
        geometry: digest of the fitted views; keys the scene that a worker keeps.
        fitted: the job that fitted the field and measured the materials.
        parts: whether the parts of the fitted geometry are also scored one by one.
        strip: whether a picture for the page is written.
        base_from_views: whether the capture's cameras tell the base colour too, where they measure the materials.
    """

    geometry: str
    fitted: Job
    parts: bool = False
    strip: bool = False
    base_from_views: bool = False


@dataclass(frozen=True)
class FittedReferenceTask(MapTask):
    """Scores a picture that Blender rendered of a fitted mesh.

    Attributes:
        picture: its path.
    """

    picture: str


@dataclass(frozen=True)
class ScoreTask(MapTask):
    """Scores rows of the table on one frame.

    Attributes:
        shot: as in `SearchTask`.
        rows: names of the rows.
        thorough: whether every metric is computed, or only the quick ones.
        constants: (roughness, metallic) of the rows with constant materials.
        strip: whether pictures for the page are written.
        keep: rows whose pictures are stored.
        lpips: the user's LPIPS weights.
    """

    shot: str
    rows: tuple[str, ...]
    thorough: bool = True
    constants: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    strip: bool = False
    keep: tuple[str, ...] = ()
    lpips: Path | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """The part of the record that a commit key holds; files enter by their digests."""
        return {
            "map": self.map, "rows": list(self.rows), "thorough": self.thorough, "strip": self.strip,
            "constants": {row: list(pair) for row, pair in self.constants.items()}, "keep": list(self.keep),
        }  # fmt: skip
