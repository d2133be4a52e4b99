"""Render jobs of the capture stage: frozen, idempotent, keyed by everything that decides their pixels."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

from yesnt.capture_stage import rigs
from yesnt.capture_stage.cameras import Matrix
from yesnt.capture_stage.rigs import Rig, pose_on_sphere
from yesnt.capture_stage.subjects import SUBJECTS, describe, is_still
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
        odd = self.elevation if self.second_elevation is None else self.second_elevation
        elevation = odd if index % 2 else self.elevation
        return pose_on_sphere(self.start + self.step * index, elevation, distance, middle)


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
        completes: the set whose shots get something more from this one: pictures of a capture if there is a `rig`, else
            Cycles' pictures of their proxy mesh.
        bounces: numbers of bounces that the truth is also rendered with; not for variants of a subject.
        rig: cameras of a capture; None: the delivered view is rendered.
        capture_map: the map that the plate and the capture are taken under.
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
    rig: Rig | None = None
    capture_map: str = CAPTURE


_ANIMATED = ("boxer", "dancer", "fox")
_OBJECTS = (
    "controller_touch", "knot", "athlete", "vase", "controller_index", "drape", "courtier", "controller_reverb",
    "fox_still", "controller_vive",
)  # fmt: skip
_RIG_SAMPLES = 16  # a capture is seen by many cameras: each may be a little noisier than the delivered view
_SMOOTH = ("knot", "courtier")

SETS: Mapping[str, CaptureSet] = MappingProxyType({
    "embedded": CaptureSet(("walk",), (1001, 1016), (CAPTURE, "sky", "studio"), 256, 384, CameraPath(-6, 0.6, 6), 4,
                         samples=64),
    "objects": CaptureSet(_OBJECTS, (1001, 1001), (CAPTURE, *_BLENDER_MAPS, *_NPM_MAPS), 256, 256,
                        CameraPath(18, 0, 16), 1),
    "reference": CaptureSet(_OBJECTS, (1001, 1001), (*_BLENDER_MAPS, *_NPM_MAPS), 256, 256, CameraPath(18, 0, 16), 1,
                          completes="objects"),
    "sequences": CaptureSet(_ANIMATED, (1001, 1024), (CAPTURE, "city", "courtyard", "photo_studio"), 256, 384,
                          CameraPath(10, -0.5, 6), 6, samples=128),  # of 32, noise alone kept PSNR below 35 to 40 dB
    "smooth": CaptureSet(_SMOOTH, (1001, 1001), (CAPTURE, *_BLENDER_MAPS, *_NPM_MAPS), 256, 256,
                       CameraPath(18, 0, 16), 1, capture_map="smooth"),
    "multiview": CaptureSet(("boxer", "vase", "fox"), (1001, 1004), (CAPTURE,), 256, 256, CameraPath(18, 0, 16), 4),
    "unmodelled": CaptureSet(("knot", "drape", "bust", "bust+skin", "bust+hair"), (1001, 1001),
                             (CAPTURE, "city", "sunset"), 192, 192, CameraPath(18, 0, 16), 1, bounces=(0, 1, 2)),
    "hair": CaptureSet(("bust+hair",), (1001, 1001), (CAPTURE,), 256, 256, CameraPath(18, 0, 16), 1),
    "embedded_capture": CaptureSet(
        ("walk",), (1001, 1016), (CAPTURE,), 192, 192, CameraPath(), 5, completes="embedded",
        samples=_RIG_SAMPLES, rig=Rig(rigs.FRONT, (1001, 1005, 1009, 1013, 1016), every=4)),
    "objects_capture": CaptureSet(
        _OBJECTS, (1001, 1001), (CAPTURE,), 256, 256, CameraPath(), 1, completes="objects",
        samples=_RIG_SAMPLES, rig=Rig(rigs.SIXTEEN, (1001,))),
    "smooth_capture": CaptureSet(
        _SMOOTH, (1001, 1001), (CAPTURE,), 256, 256, CameraPath(), 1, completes="smooth", capture_map="smooth",
        samples=_RIG_SAMPLES, rig=Rig(rigs.SIXTEEN, (1001,))),
    "sequences_capture": CaptureSet(
        _ANIMATED, (1001, 1024), (CAPTURE,), 192, 192, CameraPath(), 3, completes="sequences",
        samples=_RIG_SAMPLES, rig=Rig(rigs.TWELVE, (1001, 1003, 1005, 1009, 1012, 1013, 1017, 1021, 1024), every=4)),
    "multiview_capture": CaptureSet(
        ("boxer", "vase", "fox"), (1001, 1004), (CAPTURE,), 256, 256, CameraPath(), 1, completes="multiview",
        samples=_RIG_SAMPLES, rig=Rig(rigs.TWENTY_FOUR, (1001, 1002, 1003, 1004), rigs.BETWEEN, mesh=True)),
    "hair_capture": CaptureSet(
        ("bust+hair",), (1001, 1001), (CAPTURE,), 256, 256, CameraPath(), 1, completes="hair",
        samples=_RIG_SAMPLES, rig=Rig(rigs.SIXTEEN, (1001,), rigs.BETWEEN)),
})  # fmt: skip
"""Every set by name. `reference` needs `objects` and adds the proxy mesh, coloured by the plate, as Cycles relights it.
`unmodelled` measures effects that relighting does not model: SUBJECT+EFFECT is SUBJECT with that effect, and paths also
end early. `NAME_capture` adds the pictures of a capture's cameras to the shots of NAME. `multiview_capture` also has
cameras that are held out and the true surface, for fits of Gaussians; `hair_capture` measures mattes at hair."""

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
        cameras: of the set's rig that are rendered; none: the delivered view.
        fit: digest of the fitted view and mesh that are relit in place of the shot's plate and proxy; "": those.
    """

    set_name: str
    subject: str
    frames: tuple[int, ...]
    lights: tuple[str, ...]
    width: int
    height: int
    samples: int
    cameras: tuple[str, ...] = ()
    fit: str = ""

    @cached_property
    def key(self) -> str:
        """Digest of everything that decides the pixels."""
        stage_set = SETS[self.set_name]
        document: dict[str, Any] = {
            "version": CAPTURE_STAGE_VERSION, "job": self.to_json(), "subject": describe(self.subject),
            "path": asdict(stage_set.path), "field": stage_set.field, "moving": stage_set.moving,
        }  # fmt: skip
        if self.bounces:
            document["bounces"] = self.bounces
        if stage_set.rig is not None:
            document["rig"] = {name: asdict(stage_set.rig)[name] for name in ("rings", "held_out", "mesh")}
        if stage_set.capture_map != CAPTURE:
            document["capture_map"] = stage_set.capture_map
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
        return stage_set.path.pose(frame - stage_set.frames[0], self._distance, subject.middle)

    def camera_pose(self, name: str) -> Matrix:
        """`world_from_camera` [4, 4] of a camera of the set's rig."""
        rig = SETS[self.set_name].rig
        assert rig is not None
        azimuth, elevation = (rig.cameras | rig.held_out_cameras)[name]
        return pose_on_sphere(azimuth, elevation, self._distance, SUBJECTS[self.subject].middle)

    @property
    def _distance(self) -> float:
        """From every camera to the middle of its picture, metres."""
        shown = SUBJECTS[self.subject].height * max(1.0, self.height / self.width * 0.66)
        return SETS[self.set_name].field * shown

    def map_of(self, light: str) -> str:
        """Name of the map of one of the job's lights."""
        return SETS[self.set_name].capture_map if light == CAPTURE else light

    def seconds(self, frame: int) -> float:
        """Time of the subject's motion at a frame, in seconds."""
        stage_set = SETS[self.set_name]
        return (frame - stage_set.frames[0]) / FRAMES_PER_SECOND if stage_set.moving else 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain data; `from_json` takes it back."""
        data = asdict(self)
        for name in ("cameras", "fit"):  # keys of delivered views stay what they were before there were rigs
            if not data[name]:
                del data[name]
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> RenderJob:
        """A job from its plain data."""
        tuples = {name: tuple(data.get(name, ())) for name in ("frames", "lights", "cameras")}
        return cls(**{**data, **tuples})


def render_jobs(set_name: str, small: bool = False) -> tuple[RenderJob, ...]:
    """Every job of a set, in rendering order.

    Args:
        set_name: key of `SETS`.
        small: two objects under two maps at 64x64 instead of the objects set; for others their first frames, small.

    Raises:
        UsageError: no such set.
    """
    if set_name not in SETS:
        raise UsageError(f"There is no set {set_name!r}", "stage", ", ".join(SETS), "name one of them")
    stage_set = _shrunk(set_name) if small else SETS[set_name]
    cameras = () if stage_set.rig is None else (*stage_set.rig.cameras, *stage_set.rig.held_out_cameras)
    return tuple(
        RenderJob(
            set_name, subject, chunk, stage_set.lights, stage_set.width, stage_set.height, stage_set.samples, cameras
        )
        for subject in stage_set.subjects
        for chunk in _chunks(stage_set, subject)
    )


def shot_frames_of(stage_set: CaptureSet, subject: str) -> tuple[int, ...]:
    """Frames of a shot: one of a subject that does not move."""
    first, last = stage_set.frames
    return tuple(range(first, (first if is_still(subject) else last) + 1))


def _chunks(stage_set: CaptureSet, subject: str) -> list[tuple[int, ...]]:
    """Frames of each job of a subject."""
    frames = shot_frames_of(stage_set, subject)
    if stage_set.rig is not None:
        frames = tuple(frame for frame in stage_set.rig.frames if frame in frames)
    return [frames[i : i + stage_set.chunk] for i in range(0, len(frames), stage_set.chunk)]


def _shrunk(set_name: str) -> CaptureSet:
    stage_set = SETS[set_name]
    if "objects" in (set_name, stage_set.completes):
        lights: tuple[str, ...] = _SMALL_LIGHTS[1:] if stage_set.completes else _SMALL_LIGHTS
        lights = (CAPTURE,) if stage_set.rig is not None else lights
        return replace(stage_set, subjects=_SMALL, lights=lights, width=64, height=64, samples=16)
    first, last = stage_set.frames
    return replace(
        stage_set,
        subjects=stage_set.subjects[:1], frames=(first, min(last, first + 1)), lights=stage_set.lights[:2],
        width=stage_set.width // 4, height=stage_set.height // 4, samples=16,
    )  # fmt: skip
