"""Render jobs of the capture stage: frozen, idempotent, keyed by everything that decides their pixels."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from yesnt.capture_stage.cameras import Matrix, look_at
from yesnt.capture_stage.subjects import SUBJECTS, describe
from yesnt.core.errors import UsageError

CAPTURE_STAGE_VERSION = 1
"""Raised when the code renders something else for the same description; enters every key."""

FRAMES_PER_SECOND = 24
CAPTURE = "capture"
"""The light of the plate; every other light of a set is a truth to be relit."""

_BLENDER_MAPS = ("city", "courtyard", "forest", "interior", "night", "photo_studio", "sunrise", "sunset")
_NPM_MAPS = ("lobby", "bridge", "warehouse")


@dataclass(frozen=True)
class CameraPath:
    """A camera on a sphere about the subject, angles in degrees; 0 faces the subject, positive moves to its left."""

    start: float = 0.0
    step: float = 0.0
    elevation: float = 8.0
    second_elevation: float | None = None

    def pose(self, index: int, distance: float, middle: float) -> Matrix:
        """`world_from_camera` [4, 4] of the index-th frame; odd ones take the second elevation if there is one."""
        azimuth = np.radians(self.start + self.step * index)
        odd = self.elevation if self.second_elevation is None else self.second_elevation
        elevation = np.radians(odd if index % 2 else self.elevation)
        offset = np.array(
            [np.cos(elevation) * np.sin(azimuth), -np.cos(elevation) * np.cos(azimuth), np.sin(elevation)]
        )
        target = np.array([0.0, 0.0, middle])
        return look_at(target + distance * offset, target)


@dataclass(frozen=True)
class CaptureSet:
    """A family of shots that share lights, size and camera path.

    Attributes:
        subjects: names in `SUBJECTS`.
        frames: first and last frame.
        lights: capture first.
        width: columns.
        height: rows.
        path: of the camera.
        chunk: frames a job.
        moving: False: all frames show the first moment (views of one pose).
        samples: of Cycles, before denoising.
        field: focal length over picture height.
        completes: the set whose shots get Cycles' pictures of their proxy mesh from this one.
        bounces: numbers of bounces that the truth is also rendered with; not for variants of a subject.
    """

    subjects: tuple[str, ...]
    frames: tuple[int, int]
    lights: tuple[str, ...]
    width: int
    height: int
    path: CameraPath
    chunk: int
    moving: bool = True
    samples: int = 32
    field: float = 1.45
    completes: str | None = None
    bounces: tuple[int, ...] = ()


_ANIMATED = ("boxer", "dancer", "fox")
_OBJECTS = (
    "controller_touch", "knot", "athlete", "vase", "controller_index", "drape", "courtier", "controller_reverb",
    "fox_still", "controller_vive",
)  # fmt: skip

SETS: Mapping[str, CaptureSet] = MappingProxyType({
    "embedded": CaptureSet(("walk",), (1001, 1016), (CAPTURE, "sky", "studio"), 256, 384, CameraPath(-6, 0.6, 6), 4,
                         samples=64),
    "objects": CaptureSet(_OBJECTS, (1001, 1001), (CAPTURE, *_BLENDER_MAPS, *_NPM_MAPS), 256, 256,
                        CameraPath(18, 0, 16), 1),
    "reference": CaptureSet(_OBJECTS, (1001, 1001), (*_BLENDER_MAPS, *_NPM_MAPS), 256, 256, CameraPath(18, 0, 16), 1,
                          completes="objects"),
    "sequences": CaptureSet(_ANIMATED, (1001, 1024), (CAPTURE, "city", "courtyard", "photo_studio"), 256, 384,
                          CameraPath(10, -0.5, 6), 6, samples=128),  # of 32, noise alone kept PSNR below 35 to 40 dB
    "multiview": CaptureSet(_ANIMATED, (1001, 1024), (CAPTURE,), 256, 384, CameraPath(0, 15, 2, 24), 12, moving=False),
    "heldout": CaptureSet(_ANIMATED, (1001, 1006), (CAPTURE,), 256, 384, CameraPath(22.5, 60, 12), 6, moving=False),
    "unmodelled": CaptureSet(("knot", "drape", "bust", "bust+skin", "bust+hair"), (1001, 1001),
                             (CAPTURE, "city", "sunset"), 192, 192, CameraPath(18, 0, 16), 1, bounces=(0, 1, 2)),
})  # fmt: skip
"""Every set by name. `heldout` are views of the `multiview` subjects from elsewhere, for the Gaussian stage;
`reference` needs `objects` and adds the proxy mesh, coloured by the plate, as Cycles relights it. `unmodelled` measures
effects that relighting does not model: SUBJECT+EFFECT is SUBJECT with that effect, and paths also end early."""

_SMALL = ("vase", "knot")
"""The subset that tests render; it needs nothing fetched but Blender itself."""
_SMALL_LIGHTS = (CAPTURE, "sky", "studio")


@dataclass(frozen=True)
class RenderJob:
    """Some frames of one subject under some lights, rendered by one start of Blender.

    Attributes:
        set_name: key of `SETS`.
        subject: key of `SUBJECTS`.
        frames: frame numbers.
        lights: names of maps.
        width: columns.
        height: rows.
        samples: of Cycles, before denoising.
    """

    set_name: str
    subject: str
    frames: tuple[int, ...]
    lights: tuple[str, ...]
    width: int
    height: int
    samples: int

    @cached_property
    def key(self) -> str:
        """Digest of everything that decides the pixels."""
        stage_set = SETS[self.set_name]
        document: dict[str, Any] = {
            "version": CAPTURE_STAGE_VERSION, "job": asdict(self), "subject": describe(self.subject),
            "path": asdict(stage_set.path), "field": stage_set.field, "moving": stage_set.moving,
        }  # fmt: skip
        if self.bounces:
            document["bounces"] = self.bounces
        return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()

    @property
    def bounces(self) -> tuple[int, ...]:
        """Numbers of bounces that the truth is also rendered with."""
        return () if "+" in self.subject else SETS[self.set_name].bounces

    @property
    def focal(self) -> float:
        """Focal length in pixels, fx = fy."""
        return SETS[self.set_name].field * self.height

    def pose(self, frame: int) -> Matrix:
        """`world_from_camera` [4, 4] of any frame, also of those outside this job."""
        stage_set, subject = SETS[self.set_name], SUBJECTS[self.subject]
        shown = subject.height * max(1.0, self.height / self.width * 0.66)
        return stage_set.path.pose(frame - stage_set.frames[0], stage_set.field * shown, subject.middle)

    def seconds(self, frame: int) -> float:
        """Time of the subject's motion at a frame, in seconds."""
        stage_set = SETS[self.set_name]
        return (frame - stage_set.frames[0]) / FRAMES_PER_SECOND if stage_set.moving else 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain data; `from_json` takes it back."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> RenderJob:
        """A job from its plain data."""
        return cls(**{**data, "frames": tuple(data["frames"]), "lights": tuple(data["lights"])})


def render_jobs(set_name: str, small: bool = False) -> tuple[RenderJob, ...]:
    """Every job of a set, in rendering order.

    Args:
        set_name: "embedded", "objects", "reference", "sequences", "multiview" or "heldout".
        small: two objects under two maps at 64x64 instead of the objects set; for others their first frames, small.

    Raises:
        UsageError: no such set.
    """
    if set_name not in SETS:
        raise UsageError(f"There is no set {set_name!r}", "stage", ", ".join(SETS), "name one of them")
    stage_set = _shrunk(set_name) if small else SETS[set_name]
    first, last = stage_set.frames
    chunks = [range(start, min(start + stage_set.chunk, last + 1)) for start in range(first, last + 1, stage_set.chunk)]
    return tuple(
        RenderJob(
            set_name, subject, tuple(chunk), stage_set.lights, stage_set.width, stage_set.height, stage_set.samples
        )
        for subject in stage_set.subjects
        for chunk in chunks
    )


def _shrunk(set_name: str) -> CaptureSet:
    stage_set = SETS[set_name]
    if "objects" in (set_name, stage_set.completes):
        lights = _SMALL_LIGHTS[1:] if stage_set.completes else _SMALL_LIGHTS
        return replace(stage_set, subjects=_SMALL, lights=lights, width=64, height=64, samples=16)
    first, last = stage_set.frames
    return replace(
        stage_set,
        subjects=stage_set.subjects[:1], frames=(first, min(last, first + 1)), lights=stage_set.lights[:2],
        width=stage_set.width // 4, height=stage_set.height // 4, samples=16,
    )  # fmt: skip
