"""Relights one frame: inverts the capture light out of the plate, then lights the base colour with the new map.

Arrays in, arrays out. Source: docs/method.md section 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.combine import NOTHING_CLAMPED, Clamped, Response, normalise, response, shadow_ratio
from yesnt.relight.edges import resolve_edges
from yesnt.relight.envmap import EnvMap
from yesnt.relight.extend import CapturedLight, extend_light
from yesnt.relight.indirect import IndirectLight, ShownPixels, indirect_light
from yesnt.relight.kernels import COLUMNS, LIT, sum_lobes
from yesnt.relight.lights import PreparedLight, prepare_light
from yesnt.relight.occlusion import Occluders, find_occluders, occlusion, single_factor
from yesnt.relight.pixel_filter import boundaries, filter_light, filter_pixels, read_at_centres, short_normals
from yesnt.relight.points import Pixels, Surface, gather_pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.sparse import bands
from yesnt.relight.surroundings import Surroundings

F32 = NDArray[np.float32]

LEAST_ROWS = 32
"""Least rows of a map: smaller ones are subdivided, since a hemisphere of so few directions is off by over 1 %."""


@dataclass(frozen=True)
class FrameInputs:
    """Inputs of one frame.

    Attributes:
        plate: [H, W, 3] straight (un-premultiplied), scene-linear, in the space of the lights.
        surface: normal, z, opacity, roughness, metallic and the camera.
        base_color: known base colour [H, W, 3]; None: the capture light is divided out of the plate.
        captured: with a known base colour, what it sends out under the light of the plate (`RelitFrame.captured`);
            None: light at edges is left as it is computed.
        base_views: [H, W, 4] base colour by other views and its weight against the plate's
            (decompose/evidence/base_color.py); None: the plate's stands.
    """

    plate: NDArray[np.floating]
    surface: Surface
    base_color: NDArray[np.floating] | None = None
    captured: CapturedLight | None = None
    base_views: NDArray[np.floating] | None = None


@dataclass(frozen=True)
class RelitFrame:
    """Result of one frame: straight images, scene-linear, in the space of the lights, 0 where the opacity is 0.

    Attributes:
        base_color: [H, W, 3] 0..1, as relit.
        diffuse: [H, W, 3] radiance, with shadows and indirect radiance.
        specular: [H, W, 3] radiance, with shadows and indirect radiance.
        shadow: [H, W] relit over unshadowed luminance, 0..1; 1 outside the matte.
        clamped: pixels whose base colour would be outside [0, 1]; none where the base colour is given.
        captured: what the frame sends out under the light of the plate; None where that is not computed.
    """

    base_color: F32
    diffuse: F32
    specular: F32
    shadow: F32
    clamped: Clamped = NOTHING_CLAMPED
    captured: CapturedLight | None = None

    @property
    def radiance(self) -> F32:
        """Diffuse + specular [H, W, 3]."""
        return self.diffuse + self.specular


def prepare_relight(env: EnvMap, settings: RelightSettings) -> PreparedLight:
    """Prepares the map that relights, at the resolution of the settings; takes seconds, once per map."""
    return prepare_light(env, settings.texels, settings.clusters, **_grid(settings))


def prepare_capture(env: EnvMap, settings: RelightSettings) -> PreparedLight:
    """Prepares the map under which the plate was captured, at the resolution of the settings."""
    return prepare_light(env, settings.capture_texels, settings.capture_clusters, **_grid(settings))


def _grid(settings: RelightSettings) -> dict[str, Any]:
    """Grid options of `prepare_light`; the paper's formula sums a small map as it is, without subdivision."""
    least = 1 if settings.brdf == "paper" else LEAST_ROWS
    return {"rows": settings.rows, "least": least, "detail": settings.detail, "error": settings.error}


def relight_frame(
    inputs: FrameInputs,
    light: PreparedLight,
    capture: PreparedLight | None,
    proxy: ProxyScene | None,
    settings: RelightSettings,
    surroundings: Surroundings | None = None,
) -> RelitFrame:
    """Inverts `capture` out of the plate and lights the frame with `light`.

    Pure and deterministic: the result depends on the arguments only, to the bit, for any number of threads.

    Args:
        inputs: plate and G-buffer.
        light: of `prepare_relight`.
        capture: of `prepare_capture`.
        proxy: mesh that occludes and reflects light; None: shadows are marched in the depth buffer.
        settings: of the stage.
        surroundings: the set that the subject is relit in, which was not there when the plate was captured; it needs a
            proxy.

    Raises:
        ValueError: `capture` is None although the base colour is not given.
    """
    pixels = gather_pixels(inputs.surface)
    occluders = find_occluders(inputs.surface, pixels, proxy, settings)
    plate = np.asarray(inputs.plate, dtype=np.float32).reshape(-1, 3)[pixels.index]
    plate = np.clip(np.nan_to_num(plate, nan=0.0, posinf=65504.0, neginf=0.0), 0, None)
    clamped, captured = NOTHING_CLAMPED, inputs.captured
    if inputs.base_color is not None:
        base = np.asarray(inputs.base_color, dtype=np.float32).reshape(-1, 3)[pixels.index]
    elif capture is not None:
        base, clamped, lit = base_color(plate, pixels, occluders, capture, settings)
        captured = None if lit is None else _captured(lit, plate, pixels, inputs.surface, settings)
        base = _seen_by_views(base, inputs.base_views, pixels)
    else:
        raise ValueError("relight_frame needs the capture light or the base colour")
    occluders = occluders.within(surroundings, pixels.normal, settings.offset)
    relit = replace(shade_pixels(base, pixels, occluders, light, settings), clamped=clamped, captured=captured)
    relit = finish(relit, pixels.image(plate), inputs.surface, settings)
    return finish_silhouette(relit, inputs.surface) if settings.extend else relit


def _seen_by_views(base: F32, views: NDArray[np.floating] | None, pixels: Pixels) -> F32:
    """The base colour [P, 3] of the plate, moved to that of other views by its weight."""
    if views is None:
        return base
    seen = np.asarray(views, np.float32).reshape(-1, 4)[pixels.index]
    return base + seen[:, 3:] * (seen[:, :3] - base)


class Lit(NamedTuple):
    """Radiance of P pixels, [P, 3] each."""

    diffuse: F32
    specular: F32


def _captured(lit: Lit, plate: F32, pixels: Pixels, surface: Surface, settings: RelightSettings) -> CapturedLight:
    """What the pixels send out under the light of the plate, as images, finished as relit light is."""
    shown, nothing = pixels.image(plate), np.zeros(pixels.shape, np.float32)
    frame = RelitFrame(np.zeros_like(shown), pixels.image(lit.diffuse), pixels.image(lit.specular), nothing)
    frame = finish(frame, shown, surface, settings)
    return CapturedLight(shown, frame.diffuse, frame.specular)


def base_color(
    plate: F32, pixels: Pixels, occluders: Occluders, capture: PreparedLight, settings: RelightSettings
) -> tuple[F32, Clamped, Lit | None]:
    """Base colour of the pixels, [P, 3] in [0, 1]: the plate, or the plate with its capture light inverted.

    The second result counts the pixels that this range does not explain. The third is what they send out under the
    capture light, by computation; None where the plate is taken for the base colour.

    The indirect radiance needs the colour of the proxy, and that needs the base colour. The first estimate divides the
    plate by the irradiance of an unoccluded pixel; each pass refines both.

    Args:
        plate: [P, 3] straight scene-linear radiance, finite, at least 0.
        pixels: of the frame.
        occluders: of the frame.
        capture: the light of the plate.
        settings: `base_color` and `capture_passes` are read, and all that `integrate` reads.
    """
    if settings.base_color == "plate":
        return np.minimum(plate, 1.0), Clamped(above=int((plate > 1).any(axis=1).sum())), None
    falls = np.maximum(pixels.normal @ capture.coarse.direction, 0) @ capture.coarse.energy.T / np.float32(np.pi)
    base, clamped, lit = np.clip(plate / np.maximum(falls, 1e-3), 0, 1), NOTHING_CLAMPED, None
    for _ in range(_passes(occluders, settings)):
        sums = integrate(base, pixels, occluders, capture, settings)
        weights = response(sums, pixels, settings.brdf)
        base = weights.base_color(plate)
        clamped, lit = weights.clamped(plate, base), Lit(base * weights.diffuse, weights.specular(base))
    return base, clamped, lit


def _passes(occluders: Occluders, settings: RelightSettings) -> int:
    """Passes of the inversion: one if there is no indirect radiance."""
    indirect = occluders.proxy is not None and settings.bounce > 0
    return max(settings.capture_passes, 1) if indirect else 1


def shade_pixels(
    base: F32, pixels: Pixels, occluders: Occluders, light: PreparedLight, settings: RelightSettings
) -> RelitFrame:
    """Lights P pixels of known base colour [P, 3]; the images have the size of the frame."""
    sums = integrate(base, pixels, occluders, light, settings)
    weights: Response = response(sums, pixels, settings.brdf)
    shadow = np.ones(pixels.shape, dtype=np.float32)
    if occluders.proxy is not None or occluders.depth is not None:
        shadow.reshape(-1)[pixels.index] = shadow_ratio(sums, pixels, base, settings.brdf)
    diffuse, specular = pixels.image(base * weights.diffuse), pixels.image(weights.specular(base))
    return RelitFrame(pixels.image(base), diffuse, specular, shadow)


def finish(relit: RelitFrame, guide: F32, surface: Surface, settings: RelightSettings) -> RelitFrame:
    """Makes light at pixel centres like a plate's: resolves edges by the guide [H, W, 3], applies the pixel filter."""
    return finish_pixel_filter(finish_edges(relit, guide, surface, settings), surface, settings)


def finish_silhouette(relit: RelitFrame, surface: Surface) -> RelitFrame:
    """Extends the light of the subject outward to the pixels that it covers in part."""
    if relit.captured is None:
        return relit
    coverage = np.clip(_finite(surface.opacity), 0, 1)
    diffuse, specular = extend_light(relit.diffuse, relit.specular, relit.captured, coverage)
    return replace(relit, diffuse=diffuse, specular=specular)


def finish_pixel_filter(relit: RelitFrame, surface: Surface, settings: RelightSettings) -> RelitFrame:
    """Applies the pixel filter if the surface was sampled at pixel centres and `settings.pixel_filter` is not 0."""
    coverage = np.clip(np.nan_to_num(np.asarray(surface.opacity, dtype=np.float32)), 0, 1)
    if settings.pixel_filter == 0 or not read_at_centres(short_normals(surface.normal, coverage > 0)):
        return relit
    boundary = boundaries(_finite(surface.normal), _finite(surface.metallic))
    diffuse = filter_light(relit.diffuse, relit.base_color, boundary, coverage, settings.pixel_filter)
    return replace(relit, diffuse=diffuse, specular=filter_pixels(relit.specular, coverage, settings.pixel_filter))


def _finite(plane: NDArray[np.floating]) -> F32:
    """Copy as float32, 0 where it is not finite."""
    return np.nan_to_num(np.asarray(plane, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def finish_edges(relit: RelitFrame, guide: F32, surface: Surface, settings: RelightSettings) -> RelitFrame:
    """Resolves antialiased pixels by the guide colour [H, W, 3] if `settings.edges` is on; see relight/edges.py."""
    if not settings.edges:
        return relit
    normal, metallic = _finite(surface.normal), np.clip(_finite(surface.metallic), 0, 1)
    covered = np.nan_to_num(np.asarray(surface.opacity, dtype=np.float32)) > 0
    diffuse, specular = resolve_edges(np.stack([relit.diffuse, relit.specular]), guide, normal, metallic, covered)
    return replace(relit, diffuse=diffuse, specular=specular)


def lobe_engine(settings: RelightSettings) -> Callable[..., F32]:
    """The function that sums lobes: compiled by Numba, or by torch."""
    if settings.engine == "numba":
        return sum_lobes
    from yesnt.relight.torch_sum import sum_lobes_torch  # torch costs seconds to import

    return sum_lobes_torch


def integrate(base: F32, pixels: Pixels, occluders: Occluders, light: PreparedLight, settings: RelightSettings) -> F32:
    """Lobe sums [P, 20] of all pixels (`kernels.sum_lobes`), a band at a time so that memory stays bounded.

    Args:
        base: [P, 3] base colour, which the proxy takes its colour from.
        pixels: of the frame.
        occluders: of the frame.
        light: the light.
        settings: of the stage.
    """
    indirect = None
    if occluders.proxy is not None and settings.bounce > 0:
        source = ShownPixels(pixels, occluders.shown, base)
        indirect = indirect_light(occluders.proxy, source, light, settings, occluders.surroundings)
    return integrate_under(indirect, pixels, occluders, light, settings)


def integrate_under(
    indirect: IndirectLight | None,
    pixels: Pixels,
    occluders: Occluders,
    light: PreparedLight,
    settings: RelightSettings,
) -> F32:
    """As `integrate`, with what the triangles of `occluders` send out; None: they are black."""
    tiles = [np.zeros((0, COLUMNS), dtype=np.float32)]
    for band in bands(pixels, settings.tile):
        part = band.part
        hidden, radiance = occlusion(occluders, pixels, band, light, indirect, settings)
        lobes = pixels.lobes(part, settings.brdf, settings.diffuse)
        plain = settings.brdf == "paper"
        sums = lobe_engine(settings)(lobes, light, hidden, radiance, not plain)
        if settings.shadows == "single":
            sums[:, LIT] *= single_factor(occluders, pixels, part, light, settings)
        tiles.append(sums if plain else normalise(sums, pixels, part, settings.diffuse))
    return np.concatenate(tiles)
