"""Sections of the job file about the capture's cameras (docs/evidence.md)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from yesnt.core.color_spaces import LIN_REC709
from yesnt.core.job_part import Colorspace, Knob, Part
from yesnt.core.matting_input import Matting

CAMERA = "{camera}"
"""What stands for the name of a camera in a pattern."""


def _per_camera(pattern: str) -> str:
    if CAMERA not in pattern:
        raise ValueError(f"it needs {CAMERA}, which stands for the camera's name")
    return pattern


CameraPattern = Annotated[str, AfterValidator(_per_camera)]


Metres = Annotated[float, Field(gt=0, lt=1e6)]


class CaptureCameras(Part):
    """The calibrated cameras of the capture: a calibration (docs/capture.md), and the pictures or videos of each.

    `{camera}` stands for the camera's name. Without `mattes` the pictures' alpha is the matte. `units` is the unit of
    the calibration's lengths, or its metres; absent: as the file or its format says. `up` is the axis of its world that
    points up. `first` is the frame number of a video's first picture; `offsets` says by how many frames a camera's
    files are late. `resize: fit` says that pictures of another size than their camera's were scaled into it as a whole.
    With `matting` the run makes the mattes from the pictures; `mattes` then is their pattern in the output folder.
    """

    cameras: str
    images: CameraPattern
    mattes: CameraPattern | None = None
    colorspace: Colorspace = LIN_REC709
    units: Literal["m", "cm", "mm"] | Metres | None = None
    up: Literal["z", "-z", "y", "-y"] = "z"
    first: int = 1
    offsets: dict[str, int] = Field(default_factory=dict)
    resize: Literal["none", "fit"] = "none"
    matting: Matting | None = None

    @property
    def path(self) -> str:
        """Pattern of the pictures."""
        return self.images

    @property
    def paths(self) -> dict[str, str]:
        """Every path that is given, by its key."""
        paths = {"cameras": self.cameras, "images": self.images, "mattes": self.mattes}
        return {name: path for name, path in paths.items() if path is not None}


class EvidenceInput(Part):
    """Whether and how the capture's cameras measure the materials.

    `use: auto` measures where at least four cameras see the subject. `cameras` is the largest number of cameras of a
    frame; every `every`-th frame is measured, and the others take the result along the flow. `time: on` measures by
    other frames of the plate's own camera in place of a capture, at most `cameras` of them. `knobs` are fields of
    EvidenceSettings.
    """

    use: Literal["auto", True, False] = "auto"
    cameras: Annotated[int, Field(ge=1, le=256)] = 12
    every: Annotated[int, Field(ge=1, le=4096)] = 1
    time: bool = False
    knobs: dict[str, Knob] = Field(default_factory=dict)


def refuse_unmeasurable(capture: CaptureCameras | None, evidence: EvidenceInput, has_proxy: bool) -> None:
    """Refuses sections that do not go together.

    Raises:
        ValueError: `evidence` without `capture`, `capture` without a proxy, or `time: on` with a capture, without a
            proxy, or where `use: false` says that nothing measures.
    """
    if evidence.time:
        _refuse_untrackable(capture, evidence, has_proxy)
        return
    if evidence.use is False:
        return
    if capture is None and evidence != EvidenceInput():
        raise ValueError("`evidence` measures by the cameras of `capture`, which is absent")
    if capture is not None and not has_proxy:
        raise ValueError("`capture` needs `proxy`, which tells what a camera sees; or set evidence.use: false")


def _refuse_untrackable(capture: CaptureCameras | None, evidence: EvidenceInput, has_proxy: bool) -> None:
    if evidence.use is False:
        raise ValueError("evidence.time: on measures, and evidence.use: false says that nothing does; remove one")
    if capture is not None:
        raise ValueError("evidence.time: on measures by the plate's camera alone; with `capture` its cameras measure")
    if not has_proxy:
        raise ValueError("evidence.time: on needs `proxy`, which tells what occludes the light; or remove it")
