"""The lights of a frame as the job describes them.

A light is the frame's map, clamped, rotated, exposed and seen from the subject's place, or the capture light estimated
from the shot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.color_spaces import Conversion
from yesnt.core.errors import JobError
from yesnt.core.shot import CaptureInput, Job, LightInput
from yesnt.io import env_maps
from yesnt.io.file_digests import file_digest
from yesnt.io.jobfile import frame_path
from yesnt.io.output import OutputFolder
from yesnt.planning.stages import BAKE
from yesnt.tasks.estimated_light import estimate_files, estimated_map
from yesnt.tasks.inputs import prove_input

if TYPE_CHECKING:
    from yesnt.relight import EnvMap, PreparedLight, RelightSettings, Surface
    from yesnt.relight.sun import Sun
    from yesnt.scene.ground import Ground
    from yesnt.tasks.workspace import Workspace

Place = tuple[float, float, float]
MapInput = LightInput | CaptureInput


def frame_map(job: Job, spec: MapInput | None, frame: int) -> EnvMap:
    """The map of a frame as it was captured; without one the uniform light of radiance 1."""
    from yesnt.relight import uniform_light

    if spec is None:
        return uniform_light()
    if isinstance(spec, CaptureInput) and spec.estimate:
        return estimated_map(job).turned(*spec.turn(frame))
    conversion = job.colors.light if isinstance(spec, LightInput) else job.colors.capture_light
    return read_map(_map_path(job, spec, frame), spec, conversion).turned(*spec.turn(frame))


def read_map(path: Path, spec: MapInput, conversion: Conversion) -> EnvMap:
    """Reads a map in the working space and applies the job's convention and clamp."""
    from yesnt.relight import EnvMap

    radiance = env_maps.read_radiance(path, conversion, spec.clamp, spec.layer).values
    env = EnvMap.from_array(radiance, spec.convention)
    return env if spec.clamp is None else env.clamped(spec.clamp)


@dataclass(frozen=True)
class LightFiles:
    """The maps of one frame of a job, and the digests of the files that they are made from.

    Attributes:
        job: names the light and the capture light.
        frame: frame number; selects a map where there is one per frame.
        digests: content digests by role: "light", "capture"; of an estimate "camera" and "probe ..." (its frames).
            Prepared lights are cached by them: a map that changed on disk is never served from a worker's cache.
    """

    job: Job
    frame: int
    digests: Mapping[str, str]

    @classmethod
    def of_task(cls, space: Workspace[Any]) -> LightFiles:
        """With the digests of a task's key, and that of the map that the task's job bakes."""
        digests = dict(space.node.inputs)
        if space.job.shot.light.set:
            digests["light"] = space.committed_file(BAKE, space.job.frames[0], space.output.baked_light)
        return cls(space.job, space.frame, digests)

    @classmethod
    def read(cls, job: Job, frame: int) -> LightFiles:
        """With the digests of the files as they are now."""
        paths = _map_paths(job, frame)
        return cls(job, frame, {role: file_digest(path) for role, path in paths.items()})


def prepared_lights(
    files: LightFiles, surface: Surface, settings: RelightSettings
) -> tuple[PreparedLight, PreparedLight]:
    """The light that relights a frame and the light that its plate was captured under; cached in the worker."""
    return relighting_light(files, surface, settings), captured_light(files, surface, settings)


def relighting_light(files: LightFiles, surface: Surface, settings: RelightSettings) -> PreparedLight:
    """The light that relights a frame; cached in the worker."""
    spec = files.job.shot.light
    return _prepared(_Known(files, spec, "light"), settings, "light", _place_of(spec, surface))


def captured_light(files: LightFiles, surface: Surface, settings: RelightSettings) -> PreparedLight:
    """The light that the plate was captured under; cached in the worker."""
    spec = files.job.shot.capture_light
    place = None if spec is None else _place_of(spec, surface)
    return _prepared(_Known(files, spec, "capture"), settings, "capture", place)


def light_of_the_sun(files: LightFiles, surface: Surface, settings: RelightSettings) -> PreparedLight | None:
    """The part of `relighting_light` that its map's sun gives; None where it has no sun; cached in the worker."""
    spec = files.job.shot.light
    known, place = _Known(files, spec, "light"), _place_of(spec, surface)
    if _sun(known).share == 0:
        return None
    return _prepared_sun(known, settings, place)


def backdrop(files: LightFiles, camera: Camera, sun: bool = False) -> NDArray[np.float32]:
    """The light's map as the camera of the frame sees it: [H, W, 3]; with `sun` its sun alone."""
    spec = files.job.shot.light
    eye = tuple(float(v) for v in camera.position(files.frame))
    known = _Known(files, spec, "light")
    env = _seen(known, _chosen(known, sun), None if spec.captured_at is None else eye)
    return env.lookup(camera.rays(files.frame))


def map_behind(files: LightFiles, camera: Camera, ground: Ground, sun: bool = False) -> NDArray[np.float32]:
    """The light's map on a dome with a ground, as the camera of the frame sees it: [H, W, 3]; or its sun alone."""
    from yesnt.scene.dome import DISTANCE, EYE_HEIGHT, Dome

    spec = files.job.shot.light
    place = spec.captured_at or (*ground.centre, ground.height + EYE_HEIGHT)
    dome = Dome(place, min(ground.height, place[2] - 1e-3), spec.distance or DISTANCE)
    return dome.picture(_chosen(_Known(files, spec, "light"), sun), camera, files.frame)


class _Known:
    """A map, identified by its settings in this frame and the digests of the files that it is made from."""

    def __init__(self, files: LightFiles, spec: MapInput | None, role: str) -> None:
        spec = None if spec is None else spec.at(files.frame)
        self.job, self.spec, self.frame = files.job, spec, files.frame
        shot, digests, seen = files.job.shot, files.digests, None
        self._files: dict[str, str] = {role: digests[role]} if spec is not None and role in digests else {}
        if isinstance(spec, CaptureInput) and spec.estimate:
            self._files |= {name: digests[name] for name in sorted(digests) if name.startswith("probe ")}
            self._files["camera"] = digests["camera"]
            cameras = (shot.proxy, shot.captured) if shot.captured else ()
            sections = (shot.plate, shot.matte, shot.gbuffer, *cameras)
            seen = (*(part.model_dump_json() for part in sections if part), files.job.window, files.job.display_size)
        colors = files.job.colors
        color = colors.light if role == "light" else (colors.capture_light, colors.plate_working, colors.capture)
        self._key = (spec, tuple(self._files.items()), seen, color)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Known) and other._key == self._key

    def prove(self) -> None:
        """Raises JobError if a file is not the one that its digest names."""
        paths = _map_paths(self.job, self.frame)
        for role, digest in self._files.items():
            prove_input(paths[role], digest)


def _map_path(job: Job, spec: MapInput, frame: int) -> Path:
    """The file of a map in a frame: the job's, or the one that was baked from its scene.

    Raises:
        JobError: it is to be baked and was not yet.
    """
    if spec.path is not None:
        return frame_path(job.root, spec.path, frame)
    baked = OutputFolder.of(job).baked_light
    if not baked.exists():
        raise JobError(
            "The map that is baked from the scene is not there yet", str(baked), "a run of this job that baked it",
            "`yesnt run SHOT --until bake` makes it",
        )  # fmt: skip
    return baked


def _map_paths(job: Job, frame: int) -> dict[str, Path]:
    """Role -> file, for every file that the maps of a frame are made from."""
    specs: dict[str, MapInput | None] = {"light": job.shot.light, "capture": job.shot.capture_light}
    files = {
        role: spec for role, spec in specs.items() if spec and not (isinstance(spec, CaptureInput) and spec.estimate)
    }
    paths = {role: _map_path(job, spec, frame) for role, spec in files.items()}
    if job.shot.capture_light is not None and job.shot.capture_light.estimate:
        paths |= estimate_files(job)
    return paths


@lru_cache(maxsize=2)
def _map(known: _Known) -> EnvMap:
    env = frame_map(known.job, known.spec, known.frame)
    known.prove()
    return env


@lru_cache(maxsize=2)
def _sun(known: _Known) -> Sun:
    from yesnt.relight.sun import find_sun

    return find_sun(_map(known))


def _chosen(known: _Known, sun: bool) -> EnvMap:
    """The map, or its sun alone."""
    return _sun(known).env if sun else _map(known)


def _seen(known: _Known, env: EnvMap, place: tuple[float, ...] | None) -> EnvMap:
    """A map, or a part of it, from a place; from where it was captured if that is None."""
    spec = known.spec
    if place is None or spec is None or spec.captured_at is None or spec.distance is None:
        return env
    return env.seen_from([a - b for a, b in zip(place, spec.captured_at, strict=True)], spec.distance)


@lru_cache(maxsize=4)
def _prepared(known: _Known, settings: RelightSettings, role: str, place: Place | None) -> PreparedLight:
    from yesnt.relight import prepare_capture, prepare_relight

    prepare = prepare_capture if role == "capture" else prepare_relight
    return prepare(_seen(known, _map(known), place), settings)


@lru_cache(maxsize=2)
def _prepared_sun(known: _Known, settings: RelightSettings, place: Place | None) -> PreparedLight:
    from yesnt.relight.lights import part_of

    return part_of(_prepared(known, settings, "light", place), _seen(known, _sun(known).env, place))


def _place_of(spec: MapInput, surface: Surface) -> Place | None:
    """The subject's place in world metres, rounded to 1 mm: the median of its visible surface points."""
    if spec.captured_at is None:
        return None
    from yesnt.relight.points import gather_pixels

    pixels = gather_pixels(surface)
    if not len(pixels.index):
        return None
    x, y, z = np.median(pixels.position.astype(np.float64), axis=0).round(3).tolist()
    return (x, y, z)
