"""Measures the materials of one frame by all cameras of the capture (docs/method.md section 3b)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.decompose.evidence.base_color import base_by_views, spread_over_pixels
from yesnt.decompose.evidence.consistency import LEVELS, left_out_views, silhouette_contradiction
from yesnt.decompose.evidence.depth import on_proxy
from yesnt.decompose.evidence.fit import negative_log_likelihood
from yesnt.decompose.evidence.mirrored import occluded_share
from yesnt.decompose.evidence.nuisances import Nuisances, corrected_map, fit_nuisances
from yesnt.decompose.evidence.observe import (
    Sample,
    SeenView,
    local_deviation,
    observations,
    prepare_view,
    sample_view,
    silhouette_overlap,
)
from yesnt.decompose.evidence.pool import NEAREST, Neighbourhood, pooled, with_nearest
from yesnt.decompose.evidence.posterior import estimate, metallic_shares
from yesnt.decompose.evidence.records import FrameEvidence, Observations, Responses, View
from yesnt.decompose.evidence.responses import (
    CaptureScene,
    LitPoints,
    lit_points,
    probe_points,
    responses,
    turned_responses,
)
from yesnt.decompose.evidence.settings import EvidenceSettings, roughness_levels
from yesnt.decompose.evidence.triangles import proxy_size, shown_radiance
from yesnt.relight.frame import prepare_capture
from yesnt.relight.harmonics import TERMS
from yesnt.relight.lights import PreparedLight
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import Pixels, Surface, gather_pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.sparse import Band, bands

F32 = NDArray[np.float32]

PLATE = "plate"
"""Name of the delivered view among the cameras."""

LEAST_SIGHT = 0.03
"""Share of the subject that a camera sees, at least. One that sees less looks at it from behind: what it sees lies at
the rim, where errors of the geometry are largest, and too few points tell whether it agrees with the others."""

_PROBES = 1024
"""Points over which cameras are compared."""

_NO_LIGHT = 1e-6  # mean radiance of a capture light that is black: sigma stays above 0
_DARK = 0.01  # share of the light's mean radiance below which log colours are not told apart


@dataclass(frozen=True)
class EvidenceInputs:
    """Inputs of one frame.

    Attributes:
        plate: [H, W, 3] straight scene-linear Rec.709, finite.
        surface: G-buffer, matte and camera of the plate; its roughness and metallic are the model's estimate.
        spread: [2, H, W] standard deviation of the model's members.
        views: pictures of the capture's cameras.
        proxy: mesh of the subject.
        light: that the plate and all pictures were taken under.
    """

    plate: F32
    surface: Surface
    spread: F32
    views: list[View]
    proxy: ProxyScene
    light: PreparedLight


def measure_frame(inputs: EvidenceInputs, relight: RelightSettings, settings: EvidenceSettings) -> FrameEvidence:
    """Measures the materials of one frame.

    Pure and deterministic: the result depends on the arguments only, to the bit, for any number of threads.

    Args:
        inputs: of the frame.
        relight: settings of relighting, whose responses are used.
        settings: of the evidence.
    """
    surface, moved = on_proxy(inputs.surface, inputs.proxy, proxy_size(inputs.proxy), settings)
    inputs = replace(inputs, surface=surface)
    pixels = gather_pixels(surface)
    views, left_out = _matching_views(inputs, settings)
    scene = capture_scene(inputs, pixels, views, relight, settings)
    frame = MeasuredFrame(inputs, pixels, scene, settings)
    views, gains = frame.compare(views, left_out)
    light = frame.correct(views)
    mean, std, count = frame.measure(views)
    return FrameEvidence(mean, std, count, left_out, gains, light, int(moved.sum()), frame.base_views())


def _matching_views(inputs: EvidenceInputs, settings: EvidenceSettings) -> tuple[list[SeenView], dict[str, str]]:
    """Views whose matte agrees with the proxy, and why the others are left out."""
    found, left_out = [], {}
    for view in inputs.views:
        reason = silhouette_contradiction(*silhouette_overlap(view, inputs.proxy))
        if reason is None:
            found.append(prepare_view(view, inputs.proxy, settings))
        else:
            left_out[view.name] = reason
    return found, left_out


def capture_scene(
    inputs: EvidenceInputs, pixels: Pixels, views: list[SeenView], relight: RelightSettings, settings: EvidenceSettings
) -> CaptureScene:
    """The light with what occludes it: always the proxy, whatever shadows relighting draws."""
    relight = replace(relight, shadows=True, engine=settings.engine)
    occluders = find_occluders(inputs.surface, pixels, inputs.proxy, relight)
    shown = shown_radiance(inputs.proxy, views, settings)
    return CaptureScene(inputs.light, occluders, shown, relight)


@dataclass(frozen=True)
class _Tile:
    """A band of pixels whose likelihood is known.

    Attributes:
        part: the pixels.
        fitted: [N] which of them were fitted.
        cost: [N, R * M] minus the log likelihood; 0 where not fitted.
        log_radiance: [N, V, 3].
        seen: what the cameras saw.
        few: places of the fitted pixels in the band, in the order of `explained`.
        explained: of these what the cameras saw, with its errors, and their responses.
    """

    part: slice
    fitted: NDArray[np.bool_]
    cost: F32
    log_radiance: F32
    seen: Observations
    few: NDArray[np.intp]
    explained: tuple[Observations, Responses]


class MeasuredFrame:
    """One frame while it is measured."""

    def __init__(self, inputs: EvidenceInputs, pixels: Pixels, scene: CaptureScene, settings: EvidenceSettings) -> None:
        self._inputs, self._pixels, self._scene, self._settings = inputs, pixels, scene, settings
        self._size = proxy_size(inputs.proxy)
        self._grid = settings.roughness_levels, settings.metallic_levels
        self._rows = pixels.index // pixels.shape[1]
        texels = inputs.light.texels
        energy = luminance(texels.energy.T.astype(np.float64)).sum()
        self._mean_radiance = max(float(energy / max(float(texels.solid_angle.sum()), 1e-12)), _NO_LIGHT)
        coverage = np.nan_to_num(np.asarray(inputs.surface.opacity, np.float32))
        self._coverage = coverage.reshape(-1)[pixels.index]
        plate = np.asarray(inputs.plate, np.float32)
        self._plate, self._deviation = (a.reshape(-1, 3)[pixels.index] for a in (plate, local_deviation(plate)))
        self._plate_agrees = True
        self._gain: NDArray[np.floating] | None = None
        self._base = np.zeros((len(pixels.index), 4), np.float32)
        self._fitted = np.zeros(len(pixels.index), np.bool_)

    def _probes(self, views: list[SeenView]) -> tuple[LitPoints, list[Sample]]:
        """A few points, and what the cameras saw of them."""
        count = len(self._pixels.index)
        few = np.unique(np.linspace(0, max(count - 1, 0), min(count, _PROBES)).astype(np.intp))
        points = probe_points(self._pixels, few, self._scene)
        return points, self._all_samples(views, points.pixels, few)

    def correct(self, views: list[SeenView]) -> tuple[float, ...]:
        """Fits gains and light; returns the harmonics of the light's factor minus 1."""
        settings, env = self._settings, self._scene.light.env
        if not len(self._pixels.index) or not views or not (settings.gain_error or settings.light_error):
            return ()
        found = Nuisances(np.ones((len(views) + 1, 3)), np.zeros(TERMS))
        for _ in range(settings.passes):
            points, samples = self._probes(views)
            of = responses(points, samples, self._scene, np.array(LEVELS))
            seen = self._weighed(points, samples)
            cost = negative_log_likelihood(seen, of, settings) - np.log(metallic_shares(settings))
            ways = points.pixels.normal, np.stack([one.towards for one in samples], axis=1)
            found = found.then(fit_nuisances(seen, of, ways, (cost, np.array(LEVELS)), settings))
            light = prepare_capture(corrected_map(env, found.light), self._scene.settings)
            self._gain, self._scene = found.gain, replace(self._scene, light=light)
        return tuple(float(v) for v in found.light[1:])

    def compare(self, views: list[SeenView], left_out: dict[str, str]) -> tuple[list[SeenView], dict[str, float]]:
        """Views that agree with the others, and the gain of each camera; adds the others to `left_out`."""
        if not len(self._pixels.index) or not views:
            return views, {}
        points, samples = self._probes(views)
        of = responses(points, samples, self._scene, np.array(LEVELS))
        names = [PLATE, *(seen.view.name for seen in views)]
        found = self._weighed(points, samples)
        reasons, gains = left_out_views(names, found, of, self._settings)
        left_out |= reasons
        self._plate_agrees = PLATE not in reasons
        agreed = [seen for seen in views if seen.view.name not in reasons]
        sights = dict(zip(names, found.valid.mean(axis=0), strict=True))
        enough = [seen for seen in agreed if sights[seen.view.name] >= LEAST_SIGHT]
        agreed = enough if len(enough) >= self._settings.least_views else agreed
        if len(agreed) < len(views):
            self._scene = replace(self._scene, shown=shown_radiance(self._inputs.proxy, agreed, self._settings))
        return agreed, gains

    def measure(self, views: list[SeenView]) -> tuple[F32, F32, F32]:
        """Mean and standard deviation [2, H, W] and number of views [H, W]."""
        shape, index = self._pixels.shape, self._pixels.index
        mean = np.stack([_plane(a, shape) for a in (self._inputs.surface.roughness, self._inputs.surface.metallic)])
        std = np.asarray(self._inputs.spread, np.float32).copy()
        count = np.zeros(shape, np.float32)
        flat_mean, flat_std, flat_count = mean.reshape(2, -1), std.reshape(2, -1), count.reshape(-1)
        for tile, cost in self._pooled_tiles(views):
            views_of = tile.seen.valid.sum(axis=1)
            enough = views_of >= self._settings.least_views
            at = index[tile.part][enough]
            shaped = cost[enough].reshape(len(at), *self._grid)
            found, deviation = estimate(shaped, flat_mean[:, at].T, flat_std[:, at].T, self._settings)
            flat_mean[:, at], flat_std[:, at], flat_count[at] = found.T, deviation.T, views_of[enough]
            self._keep_base(tile, flat_mean[:, index[tile.part]].T)
        return mean, std, count

    def _keep_base(self, tile: _Tile, materials: F32) -> None:
        """What all views say of the base colour of a band's fitted pixels, at the materials [N, 2] of the band."""
        levels, at = roughness_levels(self._settings), tile.part.start + tile.few
        self._fitted[at] = True
        self._base[at] = base_by_views(*tile.explained, levels, materials[tile.few], self._settings)

    def base_views(self) -> F32:
        """Base colour by all views and its weight against the plate's, [H, W, 4]; after `measure`."""
        base, fitted = self._pixels.image(self._base), self._pixels.image(self._fitted.astype(np.float32)) > 0
        return spread_over_pixels(base, fitted, np.asarray(self._inputs.plate, np.float32))

    def _pooled_tiles(self, views: list[SeenView]) -> Iterator[tuple[_Tile, F32]]:
        """Every band with its pooled cost; only bands that neighbours reach are held."""
        cuts, held, made = bands(self._pixels, self._settings.tile), list[_Tile](), 0
        for band in cuts:
            first, last = self._rows[band.part.start], self._rows[band.part.stop - 1]
            while made < len(cuts) and self._rows[cuts[made].part.start] <= last + self._settings.radius + NEAREST:
                held.append(self._tile(cuts[made], views))
                made += 1
            held = [t for t in held if self._rows[t.part.stop - 1] >= first - self._settings.radius - NEAREST]
            tile = next(t for t in held if t.part == band.part)
            start = band.part.start - held[0].part.start
            wanted = range(start, start + len(tile.cost))
            yield tile, self._pooled(held, wanted, band.part.start, views)

    def _pooled(self, held: list[_Tile], wanted: range, first: int, views: list[SeenView]) -> F32:
        """Pooled cost of a band; pixels that no fitted neighbour looks like are fitted alone."""
        cost, weight = pooled(with_nearest(self._neighbourhood(held), self._settings), wanted, self._settings)
        alone = np.flatnonzero(weight == 0)
        if len(alone):
            points = probe_points(self._pixels, alone + first, self._scene)
            cost[alone], _ = self._cost(points, self._all_samples(views, points.pixels, alone + first))
        return cost

    def _tile(self, band: Band, views: list[SeenView]) -> _Tile:
        points = lit_points(self._pixels, self._scene, band)
        numbers = np.arange(band.part.start, band.part.stop)
        samples = self._all_samples(views, points.pixels, numbers)
        few = self._chosen(numbers)
        fitted = np.zeros(len(numbers), dtype=np.bool_)
        fitted[few] = True
        cost = np.zeros((len(numbers), self._grid[0] * self._grid[1]), dtype=np.float32)
        cost[few], explained = self._cost(points.taken(few), [one.taken(few) for one in samples])
        seen = self._observations(samples)
        log_radiance = np.log(np.maximum(seen.radiance, _DARK * self._mean_radiance))
        return _Tile(band.part, fitted, cost, log_radiance, seen, few, explained)

    def _chosen(self, numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Places in a band of the first pixel of every cell of `step` rows and columns."""
        step, width = self._settings.step, self._pixels.shape[1]
        row, column = self._rows[numbers] // step, self._pixels.index[numbers] % width // step
        return np.unique(row * width + column, return_index=True)[1].astype(np.intp)

    def _cost(self, points: LitPoints, samples: list[Sample]) -> tuple[F32, tuple[Observations, Responses]]:
        """Minus the log likelihood [N, R * M] of points that the cameras saw so, and what it is made from."""
        of = responses(points, samples, self._scene, roughness_levels(self._settings))
        degrees, turned = self._settings.normal_error, None
        if degrees:
            turned = turned_responses(points, samples, self._scene, roughness_levels(self._settings), degrees)
        weighed = self._weighed(points, samples)
        cost = likelihood_engine(self._settings)(weighed, of, self._settings, turned)
        return cost.reshape(len(cost), -1), (weighed, of)

    def _observations(self, samples: list[Sample]) -> Observations:
        return observations(samples, self._settings.floor * self._mean_radiance, self._settings)

    def _weighed(self, points: LitPoints, samples: list[Sample]) -> Observations:
        """The same, where what comes from the subject itself is known less."""
        clusters, settings = self._scene.light.clusters, self._settings
        lights = clusters.direction, clusters.solid_angle
        at = points.pixels.normal
        occluded = [occluded_share(at, one.towards, points.hits, lights, settings.sharpness) for one in samples]
        return observations(samples, settings.floor * self._mean_radiance, settings, np.stack(occluded, axis=1))

    def _plate_sample(self, pixels: Pixels, numbers: NDArray[np.intp]) -> Sample:
        """The plate at its own pixels."""
        radiance = self._plate[numbers]
        valid = (self._coverage[numbers] > 0.5) & self._plate_agrees
        footprint = self._scene.occluders.footprint[numbers]
        return Sample(radiance, self._deviation[numbers], valid, pixels.view, footprint)

    def _all_samples(self, views: list[SeenView], pixels: Pixels, numbers: NDArray[np.intp]) -> list[Sample]:
        """What the plate and every camera saw of the pixels of these numbers."""
        at = pixels.position, pixels.normal
        others = [sample_view(seen, *at, self._size, self._settings) for seen in views]
        samples = [self._plate_sample(pixels, numbers), *others]
        return samples if self._gain is None else [s.divided(g) for s, g in zip(samples, self._gain, strict=True)]

    def _neighbourhood(self, held: list[_Tile]) -> Neighbourhood:
        """The points of consecutive bands."""
        part = slice(held[0].part.start, held[-1].part.stop)
        row, column = self._rows[part] - self._rows[part.start], self._pixels.index[part] % self._pixels.shape[1]
        number = np.full((int(row[-1]) + 1, self._pixels.shape[1]), -1, dtype=np.int32)
        number[row, column] = np.arange(len(row))
        logs, cost = (np.concatenate([getattr(tile, name) for tile in held]) for name in ("log_radiance", "cost"))
        intensity = logs.mean(axis=2)
        return Neighbourhood(
            row.astype(np.int32), column.astype(np.int32), number, cost,
            logs - intensity[..., None], intensity,
            np.concatenate([tile.seen.valid for tile in held]).astype(np.uint8),
            np.concatenate([tile.fitted for tile in held]).astype(np.uint8),
            self._pixels.position[part], self._pixels.normal[part], self._scene.occluders.footprint[part],
            np.zeros((0, 0), np.float32), np.zeros(0, np.int32),
        )  # fmt: skip


_Likelihood = Callable[[Observations, Responses, EvidenceSettings, tuple[Responses, Responses] | None], F32]


def likelihood_engine(settings: EvidenceSettings) -> _Likelihood:
    """The function that computes the likelihood: compiled by Numba, or by torch."""
    if settings.engine == "numba":
        return negative_log_likelihood
    from yesnt.decompose.evidence.torch_fit import negative_log_likelihood_torch  # torch costs seconds to import

    return negative_log_likelihood_torch


def _plane(values: NDArray[np.floating], shape: tuple[int, int]) -> F32:
    return np.asarray(values, dtype=np.float32).reshape(shape).copy()
