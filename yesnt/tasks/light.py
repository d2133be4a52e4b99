"""The light that a frame sees, from what the job says of it.

The map of the frame, clamped, turned, exposed and seen from the actor's place; or the capture light estimated from the
shot.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.shot import CaptureInput, Job, LightInput
from yesnt.io import shot_inputs
from yesnt.io.jobfile import frame_path
from yesnt.planning import settings as of
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.relight import EnvMap, PreparedLight, Surface

Place = tuple[float, float, float]
MapInput = LightInput | CaptureInput


def frame_map(job: Job, spec: MapInput | None, frame: int) -> EnvMap:
    """The map of a frame as it was captured; without one the uniform light of radiance 1."""
    from yesnt.relight import uniform_light

    if spec is None:
        return uniform_light()
    if spec.path is None:
        return estimated_map(job).turned(spec.rotation, spec.exposure)
    return read_map(str(frame_path(job.root, spec.path, frame)), spec)


def read_map(path: str, spec: MapInput) -> EnvMap:
    """A file's map as the job wants it."""
    from pathlib import Path

    from yesnt.relight import EnvMap

    radiance, _ = shot_inputs.read_radiance(Path(path))
    env = EnvMap.from_array(radiance, spec.convention)
    env = env if spec.clamp is None else env.clamped(spec.clamp)
    return env.turned(spec.rotation, spec.exposure)


def estimated_map(job: Job) -> EnvMap:
    """The capture light as the probe frames' own shading tells it."""
    from yesnt.relight import Surface, estimate_capture

    camera = Camera.open(frame_path(job.root, job.shot.camera, 0))
    plates, surfaces = [], []
    for frame in job.probe_frames:
        plate, seen = shot_inputs.read_plate(job, frame), shot_inputs.read_surface(job, frame, camera)
        unknown = np.zeros_like(seen.z)  # an estimate asks for no material
        plates.append(plate.color)
        surfaces.append(Surface(seen.normal, seen.z, plate.matte, unknown, unknown, camera, frame))
    return estimate_capture(plates, surfaces)


def prepared_lights(space: Workspace, surface: Surface) -> tuple[PreparedLight, PreparedLight]:
    """The light that relights a frame and the light of its plate; maps stay in the worker."""
    shot, settings = space.job.shot, of.relight_settings(space.job.shot)
    parts = (("light", shot.light), ("capture", shot.capture_light))
    light, captured = (
        _prepared(_Known(space, spec, role), settings, role, None if spec is None else _place_of(spec, surface))
        for role, spec in parts
    )
    return light, captured


def backdrop(space: Workspace, camera: Camera) -> NDArray[np.float32]:
    """The light's map as the camera of the node's frame sees it: [H, W, 3]."""
    frame, spec = space.node.frames[0], space.job.shot.light
    eye = tuple(float(v) for v in camera.position(frame))
    env = _seen(_Known(space, spec, "light"), None if spec.captured_at is None else eye)
    return env.lookup(camera.rays(frame))


class _Known:
    """A map of a node, known by its spec and the digests of the files that make it."""

    def __init__(self, space: Workspace, spec: MapInput | None, role: str) -> None:
        self.job, self.spec, self.frame = space.job, spec, space.node.frames[0]
        inputs = space.node.fields["inputs"]
        probes = tuple(inputs[name] for name in sorted(inputs) if name.startswith("probe "))
        self.key = (spec, inputs.get(role), probes if isinstance(spec, CaptureInput) else ())

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Known) and other.key == self.key


@lru_cache(maxsize=2)
def _map(known: _Known) -> EnvMap:
    return frame_map(known.job, known.spec, known.frame)


def _seen(known: _Known, place: tuple[float, ...] | None) -> EnvMap:
    """The map from a place; from where it was captured if that is None."""
    env, spec = _map(known), known.spec
    if place is None or spec is None or spec.captured_at is None or spec.distance is None:
        return env
    return env.seen_from([a - b for a, b in zip(place, spec.captured_at, strict=True)], spec.distance)


@lru_cache(maxsize=4)
def _prepared(known: _Known, settings: Any, role: str, place: Place | None) -> PreparedLight:
    from yesnt.relight import prepare_capture, prepare_relight

    prepare = prepare_capture if role == "capture" else prepare_relight
    return prepare(_seen(known, place), settings)


def _place_of(spec: MapInput, surface: Surface) -> Place | None:
    """Where the actor stands, world metres to the millimetre: the median of what the camera sees of them."""
    if spec.captured_at is None:
        return None
    from yesnt.relight.points import gather_pixels

    pixels = gather_pixels(surface)
    if not len(pixels.index):
        return None
    x, y, z = np.median(pixels.position.astype(np.float64), axis=0).round(3).tolist()
    return (x, y, z)
