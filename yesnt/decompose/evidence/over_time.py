"""Materials of one frame measured by one camera over time: the frames along its tracks are the views.

The camera and the light stand still and the subject turns, so that each frame shows a point with another normal. Every
view therefore has its own points, its own visibility and its own proxy; likelihood, pooling and posterior are those of
several cameras (frame.py).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.depth import on_proxy
from yesnt.decompose.evidence.frame import EvidenceInputs, MeasuredFrame, capture_scene, likelihood_engine
from yesnt.decompose.evidence.mirrored import occluded_share
from yesnt.decompose.evidence.observe import Sample, SeenView, local_deviation, observations, prepare_view
from yesnt.decompose.evidence.records import FrameEvidence, Observations, Responses, View
from yesnt.decompose.evidence.responses import CaptureScene, LitPoints, probe_points, responses
from yesnt.decompose.evidence.settings import EvidenceSettings, roughness_levels
from yesnt.decompose.evidence.triangles import proxy_size
from yesnt.relight.points import Pixels, gather_pixels
from yesnt.relight.settings import RelightSettings

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class Moment:
    """Another frame of the camera.

    Attributes:
        inputs: of that frame; its views are not used.
        place: [H, W, 2] (column, row) there of each pixel of the measured frame; NaN where the track is lost.
    """

    inputs: EvidenceInputs
    place: F32


def measure_over_time(
    inputs: EvidenceInputs, moments: list[Moment], relight: RelightSettings, settings: EvidenceSettings
) -> FrameEvidence:
    """Measures the materials of one frame by other frames of the same camera.

    Pure and deterministic, as `frame.measure_frame`. Gains and light are taken as they are.

    Args:
        inputs: of the frame; its views are not used.
        moments: the other frames.
        relight: settings of relighting, whose responses are used.
        settings: of the evidence.
    """
    now = _Shown.of(inputs, relight, settings)
    others = [_Shown.of(moment.inputs, relight, settings) for moment in moments]
    frame = _TrackedFrame(now, list(zip(others, (m.place for m in moments), strict=True)), settings)
    mean, std, count = frame.measure([])
    return FrameEvidence(mean, std, count, {}, {}, (), now.moved)


@dataclass(frozen=True)
class _Shown:
    """A frame with its points and what lights them.

    Attributes:
        inputs: of the frame, with z of the proxy where both contradict each other.
        pixels: its points.
        scene: light and proxy.
        number: [H, W] of the point at each pixel, -1 where there is none or coverage is not whole.
        radiance: [P, 3] of the plate.
        deviation: [P, 3] within 3 x 3 pixels.
        moved: pixels whose point was taken from the proxy.
    """

    inputs: EvidenceInputs
    pixels: Pixels
    scene: CaptureScene
    number: NDArray[np.int64]
    radiance: F32
    deviation: F32
    moved: int

    @classmethod
    def of(cls, inputs: EvidenceInputs, relight: RelightSettings, settings: EvidenceSettings) -> _Shown:
        """Of one frame; the plate itself tells what the proxy's triangles send."""
        surface, moved = on_proxy(inputs.surface, inputs.proxy, proxy_size(inputs.proxy), settings)
        inputs, pixels = replace(inputs, surface=surface), gather_pixels(surface)
        plate = np.asarray(inputs.plate, np.float32)
        coverage = np.nan_to_num(np.asarray(surface.opacity, np.float32))
        view = prepare_view(View("plate", surface.camera, surface.frame, plate, coverage), inputs.proxy, settings)
        scene = capture_scene(inputs, pixels, [view], relight, settings)
        whole = coverage.reshape(-1)[pixels.index] > settings.covered
        number = np.full(coverage.size, -1)
        number[pixels.index] = np.where(whole, np.arange(len(whole)), -1)
        radiance, deviation = (a.reshape(-1, 3)[pixels.index] for a in (plate, local_deviation(plate)))
        return cls(inputs, pixels, scene, number.reshape(coverage.shape), radiance, deviation, int(moved.sum()))


@dataclass(frozen=True)
class _Tracked(Sample):
    """What another frame shows of P points.

    Attributes:
        number: [P] of the point there; any where not valid.
        shown: that frame.
    """

    number: NDArray[np.int64]
    shown: _Shown

    def taken(self, which: NDArray[np.intp]) -> _Tracked:
        """Some of the points."""
        own = {one.name: getattr(self, one.name)[which] for one in fields(self) if one.name != "shown"}
        return _Tracked(**own, shown=self.shown)

    def points(self) -> tuple[NDArray[np.intp], LitPoints]:
        """Places of the valid points, and these points in their own frame, traced."""
        seen = np.flatnonzero(self.valid)
        return seen, probe_points(self.shown.pixels, self.number[seen], self.shown.scene)


class _TrackedFrame(MeasuredFrame):
    """A frame whose views are frames of the same camera."""

    def __init__(self, now: _Shown, others: list[tuple[_Shown, F32]], settings: EvidenceSettings) -> None:
        super().__init__(now.inputs, now.pixels, now.scene, settings)
        self._now, self._others = now, others

    def _all_samples(self, views: list[SeenView], pixels: Pixels, numbers: NDArray[np.intp]) -> list[Sample]:
        """What the frame itself and the others show of the pixels of these numbers."""
        own = np.stack(np.unravel_index(pixels.index, pixels.shape)[::-1], axis=-1).astype(np.float32)
        found = [_tracked(self._now, own, self._settings)]
        for shown, place in self._others:
            found.append(_tracked(shown, place.reshape(-1, 2)[pixels.index], self._settings))
        return list(found)

    def _cost(self, points: LitPoints, samples: list[Sample]) -> tuple[F32, tuple[Observations, Responses]]:
        """As of several cameras, but responses and occlusion of each view are those of its own frame."""
        count, levels = len(points.hits), roughness_levels(self._settings)
        of, occluded = [], np.zeros((count, len(samples)), np.float32)
        for v, sample in enumerate(samples):
            assert isinstance(sample, _Tracked)
            seen, lit = sample.points()
            few = sample.taken(seen)
            of.append(_spread(responses(lit, [few], sample.shown.scene, levels), seen, count))
            clusters = sample.shown.scene.light.clusters
            lights = clusters.direction, clusters.solid_angle
            share = occluded_share(lit.pixels.normal, few.towards, lit.hits, lights, self._settings.sharpness)
            occluded[seen, v] = share
        weighed = observations(samples, self._settings.floor * self._mean_radiance, self._settings, occluded)
        joined = _joined(of)
        cost = likelihood_engine(self._settings)(weighed, joined, self._settings, None)
        return cost.reshape(len(cost), -1), (weighed, joined)


def _tracked(shown: _Shown, place: F32, settings: EvidenceSettings) -> _Tracked:
    """What a frame shows at places [P, 2]; the nearest pixel, so that colour and geometry belong together."""
    height, width = shown.number.shape
    known = np.asarray(np.isfinite(place).all(axis=1))
    column, row = np.rint(np.where(known[:, None], place, -1)).astype(np.int64).T
    inside = known & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    number = np.where(inside, shown.number[np.where(inside, row, 0), np.where(inside, column, 0)], -1)
    at, pixels = np.maximum(number, 0), shown.pixels
    cosine = (pixels.normal[at] * pixels.view[at]).sum(axis=1)
    valid = (number >= 0) & (cosine > settings.cosine)
    radiance = np.where(valid[:, None], shown.radiance[at], 0).astype(np.float32)
    footprint = shown.scene.occluders.footprint[at]
    return _Tracked(radiance, shown.deviation[at], valid, pixels.view[at], footprint, at, shown)


def _spread(of: Responses, seen: NDArray[np.intp], count: int) -> Responses:
    """Responses of `count` points, 0 but for those that are seen."""

    def wide(values: F32) -> F32:
        out = np.zeros((count, *values.shape[1:]), np.float32)
        out[seen] = values
        return out

    return Responses(
        wide(of.diffuse), wide(of.dielectric), wide(of.metal_f0), wide(of.metal_f90), wide(of.missing), of.average
    )


def _joined(of: list[Responses]) -> Responses:
    """Responses of several views, each made alone."""
    names = ("diffuse", "dielectric", "metal_f0", "metal_f90", "missing")
    planes = {name: np.concatenate([getattr(one, name) for one in of], axis=1) for name in names}
    seen = next((one for one in of if one.missing.any()), of[0])
    return Responses(**planes, average=seen.average)
