"""One frame of a shot as the relighting kernels want it, and a row's relit picture of it."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.jobfile import frame_path, has_frame_number
from yesnt.io.mesh import read_mesh
from yesnt.measure.evaluation.rows import Row
from yesnt.planning import settings as of
from yesnt.relight import (
    EnvMap,
    PreparedLight,
    ProxyScene,
    RelightSettings,
    Surface,
    prepare_capture,
    prepare_relight,
)
from yesnt.relight.frame import base_color, finish, shade_pixels
from yesnt.relight.occlusion import Occluders, find_occluders
from yesnt.relight.points import Pixels, gather_pixels
from yesnt.tasks.light import frame_map

F32 = NDArray[np.float32]


_REMEMBERED = 32
"""Bundles of rays whose hits are kept: those of one frame of the stage under one map and the capture light."""


class RememberingProxy(ProxyScene):
    """A proxy that keeps what it was last asked: rows and candidates differ in materials, and rays do not see these."""

    @cached_property
    def _known(self) -> dict[bytes, NDArray[np.int32]]:
        return {}

    def first_hits(self, origins: F32, directions: F32) -> NDArray[np.int32]:
        """As `ProxyScene.first_hits`, bit for bit."""
        key = _digest(origins, directions)
        hits = self._known.pop(key, None)
        if hits is None:
            hits = super().first_hits(origins, directions)
        self._known[key] = hits  # the latest stands last
        if len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]
        return hits


def _digest(*arrays: NDArray[np.floating]) -> bytes:
    made = hashlib.blake2b(digest_size=16)
    for array in arrays:
        made.update(np.ascontiguousarray(array).data)
    return made.digest()


@dataclass(frozen=True)
class Scene:
    """What one frame brings along, whatever lights it.

    Attributes:
        job: of the shot.
        frame: its number.
        stride: pixels of which only every stride-th in both directions is shaded (for searches); 1: all.
    """

    job: Job
    frame: int
    stride: int = 1

    @cached_property
    def camera(self) -> Camera:
        """The shot's camera."""
        return Camera.open(frame_path(self.job.root, self.job.shot.camera, 0))

    @cached_property
    def plate(self) -> shot_inputs.Plate:
        """The captured picture."""
        return shot_inputs.read_plate(self.job, self.frame)

    @cached_property
    def matte(self) -> F32:
        """Coverage [H, W] of the pixels that are shaded."""
        chosen = np.zeros_like(self.plate.matte)
        chosen[:: self.stride, :: self.stride] = 1
        return self.plate.matte * chosen

    @cached_property
    def seen(self) -> shot_inputs.Surface:
        """The G-buffer."""
        return shot_inputs.read_surface(self.job, self.frame, self.camera)

    @cached_property
    def proxy(self) -> ProxyScene | None:
        """The proxy mesh."""
        if self.job.shot.proxy is None:
            return None
        mesh = read_mesh(frame_path(self.job.root, self.job.shot.proxy.path, self.frame))
        return RememberingProxy.from_arrays(mesh.vertices, mesh.faces)

    @property
    def settings(self) -> RelightSettings:
        """The shot's relighting."""
        return of.relight_settings(self.job.shot)

    def relit(self, row: Row, planes: F32, env: Path, true_base: F32 | None = None) -> F32:
        """Straight radiance [H, W, 3] of a row.

        Args:
            row: how the picture is made.
            planes: [2, H, W] roughness and metallic.
            env: file of the light, in Blender's convention.
            true_base: [H, W, 3] base colour, for rows that are given it.
        """
        settings = dataclasses.replace(self.settings, **row.knobs)
        surface = Surface(self.seen.normal, self.seen.z, self.matte, planes[0], planes[1], self.camera, self.frame)
        pixels = gather_pixels(surface)
        occluders = find_occluders(surface, pixels, self.proxy if row.proxy else None, settings)
        if row.true_base:
            assert true_base is not None
            base = true_base.reshape(-1, 3)[pixels.index]
        else:
            base = self._base(pixels, occluders, settings, (row.proxy, _digest(planes)))
        relit = shade_pixels(base, pixels, occluders, new_light(env, settings), settings)
        return finish(relit, pixels.image(self._color(pixels)), surface, settings).radiance

    def _base(self, pixels: Pixels, occluders: Occluders, settings: RelightSettings, way: tuple[Any, ...]) -> F32:
        """Base colour [P, 3] out of the plate; the light that relights has no part in it, so all maps share one."""
        key = (*way, dataclasses.replace(settings, texels=1, clusters=1))
        if key not in self._bases:
            captured = captured_light(self.job, self.frame, settings)
            self._bases[key] = base_color(self._color(pixels), pixels, occluders, captured, settings)
        return self._bases[key]

    def _color(self, pixels: Pixels) -> F32:
        return self.plate.color.reshape(-1, 3)[pixels.index]

    @cached_property
    def _bases(self) -> dict[Any, F32]:
        return {}


@dataclass(frozen=True)
class SceneKey:
    """What a scene is known by.

    Attributes:
        digest: of the job's place and of every file that the scene reads.
        frame: its number.
        stride: as for `Scene`.
        job: of the shot.
    """

    digest: str
    frame: int
    stride: int
    job: Job = field(compare=False)


@lru_cache(maxsize=1)
def open_scene(key: SceneKey) -> Scene:
    """A frame that stays in the worker from map to map."""
    return Scene(key.job, key.frame, key.stride)


def captured_light(job: Job, frame: int, settings: RelightSettings) -> PreparedLight:
    """The light of the plate, as the job names it."""
    path = job.shot.capture_light.path if job.shot.capture_light is not None else None
    if path is not None and has_frame_number(path):
        return _captured(_Capture((job.root, path, frame), job), frame, settings)
    return _captured(_Capture((job.root, path), job), job.frames[0], settings)


@dataclass(frozen=True)
class _Capture:
    """What a capture light is known by, and the job that tells the rest."""

    known_by: tuple[str | int | None, ...]
    job: Job = field(compare=False)


@lru_cache(maxsize=4)
def _captured(capture: _Capture, frame: int, settings: RelightSettings) -> PreparedLight:
    return prepare_capture(frame_map(capture.job, capture.job.shot.capture_light, frame), settings)


@lru_cache(maxsize=4)
def new_light(env: Path, settings: RelightSettings) -> PreparedLight:
    """A map of the set, as Blender had it."""
    return prepare_relight(EnvMap.from_array(shot_inputs.read_radiance(env)[0]), settings)
