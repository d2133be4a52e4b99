"""Runs single stages on a few frames of a shot in memory, with other settings than the shot's."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.color import srgb_encode
from yesnt.decompose.confidence import confidence
from yesnt.decompose.registry import open_backend
from yesnt.decompose.reuse import Link, propagate_keyframe
from yesnt.decompose.settings import EnsembleSettings, keyframe_after
from yesnt.io import shot_inputs
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.measure.evaluation.subjects import Subject
from yesnt.planning import settings as of
from yesnt.relight import ProxyScene, RelightSettings
from yesnt.runtime.session import Session
from yesnt.tasks.light import LightFiles, prepared_lights
from yesnt.tasks.relight_inputs import RelightInputs, proxy_scene, read_proxy, relight
from yesnt.temporal import FlowSettings, flow_and_validity, robust_confidence, solve

Float32 = NDArray[np.float32]


@dataclass
class Spent:
    """Processor seconds of one stage, and network evaluations (NFE)."""

    seconds: float = 0.0
    evaluations: int = 0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Adds the processor time inside."""
        start = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - start


@dataclass(frozen=True)
class Found:
    """What a variant shows and costs.

    Attributes:
        shown: [n, 3] display-referred, of the pixels that are compared.
        seconds: processor seconds per frame.
        evaluations: network evaluations (NFE) per frame.
    """

    shown: Float32
    seconds: float
    evaluations: float = 0.0


@dataclass
class Harness:
    """Runs the kernel of each stage in memory on some consecutive frames.

    Attributes:
        session: the shot.
        frames: frame numbers.
    """

    session: Session
    frames: tuple[int, ...]
    _flows: dict[str, tuple[list[Link], Spent]] = field(default_factory=dict)
    _backends: dict[tuple[tuple[str, Any], ...], Any] = field(default_factory=dict)

    @cached_property
    def plates(self) -> list[shot_inputs.Plate]:
        """Colour and matte of every frame."""
        return [shot_inputs.read_plate(self.session.job, frame) for frame in self.frames]

    @cached_property
    def mattes(self) -> NDArray[np.bool_]:
        """[T, H, W]."""
        return np.stack([plate.matte > 0.5 for plate in self.plates])

    def links(self, method: str) -> tuple[list[Link], Spent]:
        """Flow from each frame to the next; computed once per method."""
        if method not in self._flows:
            spent, links = Spent(), []
            for now, then in zip(self.plates, self.plates[1:], strict=False):
                with spent.counted():
                    found = flow_and_validity(
                        now.color,
                        then.color,
                        now.matte,
                        then.matte,
                        FlowSettings(method=method),  # type: ignore[arg-type]
                    )
                links.append(Link(*found))
            self._flows[method] = links, spent
        return self._flows[method]

    def observe(self, settings: EnsembleSettings, knobs: dict[str, Any], method: str) -> tuple[Float32, Float32, Spent]:
        """Mean and standard deviation [2, T, H, W] of the members; keyframes first, then the frames between."""
        from yesnt.decompose.ensemble import Estimate, estimate_frame

        backend, spent = self._backend(knobs), Spent()
        links, seed = self.links(method)[0], self.session.job.shot.seed
        found: dict[int, Estimate] = {}
        length = len(self.frames)
        keys = {p: keyframe_after(p, length, settings.keyframe_step) for p in range(length)}
        for position in sorted(keys, key=lambda p: keys[p] != p):
            key, plate = keys[position], self.plates[position]
            with spent.counted():
                prior = None
                if key != position:
                    way = self.mattes[position : key + 1]
                    prior = propagate_keyframe(
                        found[key].mean, found[key].std, links[position:key], list(way), settings
                    )
                found[position] = estimate_frame(
                    plate.color, plate.matte, backend, settings, seed, self.frames[position], prior
                )
            spent.evaluations += found[position].total_nfe
        mean, std = (np.stack([getattr(found[p], name) for p in range(length)], axis=1) for name in ("mean", "std"))
        return mean, std, spent

    def fuse(self, mean: Float32, std: Float32, method: str, tolerance: float) -> tuple[Float32, Spent]:
        """The temporal solve [2, T, H, W] of the observation, with the shot's own energy."""
        shot, spent = self.session.job.shot, Spent()
        links = self.links(method)[0]
        flow, validity = np.stack([link.flow for link in links]), np.stack([link.validity for link in links])
        with spent.counted():
            weight = confidence(std)
            if shot.temporal.robust:
                weight, _ = robust_confidence(mean, weight, flow, validity, self.mattes)
            value = solve(mean, weight, flow, validity, of.energy_params(shot), self.mattes, tolerance).value
        return value, spent

    @property
    def middle(self) -> int:
        """Position of the frame that stands for all."""
        return len(self.frames) // 2

    def bare(self, position: int) -> RelightInputs:
        """Plate in the working space, G-buffer and camera of a frame, without its proxy."""
        job, frame = self.session.job, self.frames[position]
        gbuffer = shot_inputs.read_surface(job, frame, self._camera)
        return RelightInputs(shot_inputs.read_plate(job, frame, working=True), gbuffer, self._camera, frame, None)

    def shown(self, material: Float32, quality: str, position: int | None = None) -> tuple[Float32, Spent]:
        """A frame relit, by default the middle one, display-referred [n, 3] inside the matte.

        Preparing the lights is not counted: it is done once per shot, not once per frame.
        """
        position = self.middle if position is None else position
        settings, spent, bare = self._relight_settings(quality), Spent(), self.bare(position)
        job, frame, planes = self.session.job, self.frames[position], material[:, position]
        lights = prepared_lights(LightFiles.read(job, frame), bare.surface(planes), settings)
        with spent.counted():
            inputs = replace(bare, proxy=proxy_scene(read_proxy(job, frame), ProxyScene))
            relit = relight(inputs, planes, lights, settings)
        return srgb_encode(relit.radiance)[bare.plate.matte > 0.5].astype(np.float32), spent

    @cached_property
    def _camera(self) -> Camera:
        return shot_camera(self.session.job)

    def _relight_settings(self, quality: str) -> RelightSettings:
        return of.relight_settings(self.session.job.shot.model_copy(update={"quality": quality}))

    def _backend(self, knobs: dict[str, Any]) -> Any:
        key, shot = tuple(sorted(knobs.items())), self.session.job.shot
        if key not in self._backends:
            weights = of.weights_path(self.session.job.root, shot)
            self._backends = {key: open_backend(shot.decompose.backend, weights, shot.decompose.accept_license, knobs)}
        return self._backends[key]


def true_materials(harness: Harness, positions: Sequence[int]) -> Float32 | None:
    """True roughness and metallic [2, T, H, W], known at some positions and 0 elsewhere; None without truth."""
    root = Path(harness.session.job.root)
    subject, frames = Subject(root, root.name, ()), harness.frames
    if not all(subject.material_path(frames[p]).is_file() for p in positions):
        return None
    planes = np.zeros((2, *harness.mattes.shape), np.float32)
    for p in positions:
        planes[:, p] = subject.read_material(frames[p], harness.plates[p].matte).planes
    return planes
