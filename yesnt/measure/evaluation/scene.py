"""The inputs of one frame of a shot, cached in a worker, and the relit picture of any row."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.shot import Job
from yesnt.io import env_maps, shot_inputs
from yesnt.io.file_digests import file_digest
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.measure.evaluation.rows import Row
from yesnt.planning import settings as of
from yesnt.relight import EnvMap, PreparedLight, ProxyScene, RelightSettings, prepare_relight
from yesnt.tasks.light import LightFiles, captured_light
from yesnt.tasks.relight_inputs import RelightInputs, proxy_scene, read_proxy, relight

F32 = NDArray[np.float32]


_CACHED_QUERIES = 32
"""Ray queries whose hits are cached: those of one frame under one map and the capture light."""


class CachingProxy(ProxyScene):
    """A proxy that caches ray hits (LRU): rows differ in materials, which hits do not depend on."""

    @cached_property
    def _cache(self) -> dict[bytes, NDArray[np.int32]]:
        return {}

    def first_hits(self, origins: F32, directions: F32) -> NDArray[np.int32]:
        """Triangle indices as from `ProxyScene.first_hits`, bit for bit."""
        key = _digest(origins, directions)
        hits = self._cache.pop(key, None)
        if hits is None:
            hits = super().first_hits(origins, directions)
        self._cache[key] = hits  # the most recent is last
        if len(self._cache) > _CACHED_QUERIES:
            del self._cache[next(iter(self._cache))]
        return hits


def _digest(*arrays: NDArray[np.floating]) -> bytes:
    made = hashlib.blake2b(digest_size=16)
    for array in arrays:
        made.update(np.ascontiguousarray(array).data)
    return made.digest()


@dataclass(frozen=True)
class Scene:
    """The inputs of one frame that do not depend on the new light; relights the frame for any row.

    Attributes:
        job: of the shot.
        frame: frame number.
        stride: only every stride-th pixel in both directions is shaded (for searches); 1: all.
    """

    job: Job
    frame: int
    stride: int = 1

    @cached_property
    def plate(self) -> shot_inputs.Plate:
        """The captured picture."""
        return shot_inputs.read_plate(self.job, self.frame)

    @property
    def matte(self) -> F32:
        """Coverage [H, W] of the pixels that are shaded."""
        return self._inputs.plate.matte

    def relit(
        self, row: Row, planes: F32, env: Path, true_base: F32 | None = None, base_views: F32 | None = None
    ) -> F32:
        """Straight radiance [H, W, 3] of a row.

        Args:
            row: materials, proxy and settings of the picture.
            planes: [2, H, W] roughness and metallic.
            env: file of the light, in Blender's convention.
            true_base: [H, W, 3] base colour, for rows that are given it.
            base_views: [H, W, 4] base colour by other views and its weight against the plate's; None: the plate's.
        """
        settings = dataclasses.replace(of.relight_settings(self.job.shot), **row.knobs)
        inputs = self._inputs if row.proxy else dataclasses.replace(self._inputs, proxy=None)
        light = _new_light(env, file_digest(env), settings)
        # The light that relights has no part in the base colour, so all maps share what the first one found.
        told = None if base_views is None else _digest(base_views)
        key = (row.proxy, _digest(planes), told, dataclasses.replace(settings, texels=1, clusters=1))
        base = true_base if row.true_base else self._known_base(key)
        captured = captured_light(self._lights, inputs.surface(planes), settings) if base is None else None
        relit = relight(inputs, planes, (light, captured), settings, base, base_views=base_views)
        if not row.true_base:
            self._bases[key] = relit.base_color[self.matte > 0]
        return relit.radiance

    def _known_base(self, key: Any) -> F32 | None:
        """Cached base colour [H, W, 3] or None; only the shaded pixels are kept, to save memory."""
        if key not in self._bases:
            return None
        base = np.zeros((*self.matte.shape, 3), np.float32)
        base[self.matte > 0] = self._bases[key]
        return base

    @cached_property
    def _inputs(self) -> RelightInputs:
        camera = shot_camera(self.job)
        chosen = np.zeros_like(self.plate.matte)
        chosen[:: self.stride, :: self.stride] = 1
        plate = dataclasses.replace(self.plate, matte=self.plate.matte * chosen)
        gbuffer = shot_inputs.read_surface(self.job, self.frame, camera)
        proxy = proxy_scene(read_proxy(self.job, self.frame), CachingProxy)
        return RelightInputs(plate, gbuffer, camera, self.frame, proxy)

    @cached_property
    def _lights(self) -> LightFiles:
        return LightFiles.read(self.job, self.frame)

    @cached_property
    def _bases(self) -> dict[Any, F32]:
        return {}


PARTS = {
    "plate": "colour and matte of the plate",
    "normals": "normals",
    "z": "z",
    "proxy": "the proxy that casts shadows and bounces light",
}
"""What a fitted field gives a scene, part by part."""


@dataclass(frozen=True)
class ExchangedScene(Scene):
    """A scene with one part of another one's inputs; pixels that the other does not cover keep their own surface.

    Attributes:
        given: the scene itself.
        other: where the part comes from; of the same camera and frame.
        part: one of `PARTS`.
    """

    given: Scene = field(kw_only=True)
    other: Scene = field(kw_only=True)
    part: str = field(kw_only=True)

    @cached_property
    def _inputs(self) -> RelightInputs:
        mine, theirs = self.given._inputs, self.other._inputs
        if self.part in ("plate", "proxy"):
            return dataclasses.replace(mine, **{self.part: getattr(theirs, self.part)})
        surface, there = mine.gbuffer, theirs.gbuffer.z > 0
        name = {"normals": "normal"}.get(self.part, self.part)
        values, taken = getattr(surface, name), getattr(theirs.gbuffer, name)
        mixed = np.where(there[..., None] if values.ndim > there.ndim else there, taken, values)
        return dataclasses.replace(mine, gbuffer=dataclasses.replace(surface, **{name: mixed}))


@dataclass(frozen=True)
class SceneKey:
    """Key of a scene in a worker's cache.

    Attributes:
        digest: of the job's folder and of every file that the scene reads.
        frame: frame number.
        stride: as for `Scene`.
        job: of the shot.
    """

    digest: str
    frame: int
    stride: int
    job: Job = field(compare=False)


@lru_cache(maxsize=1)
def open_scene(key: SceneKey) -> Scene:
    """The scene of a key; the latest one stays in the worker from map to map."""
    return Scene(key.job, key.frame, key.stride)


@lru_cache(maxsize=4)
def _new_light(env: Path, digest: str, settings: RelightSettings) -> PreparedLight:
    """A map of the test set in Blender's convention; the file's digest is part of the cache's key."""
    del digest
    return prepare_relight(EnvMap.from_array(env_maps.read_radiance(env).values), settings)
