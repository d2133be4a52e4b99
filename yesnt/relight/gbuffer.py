"""Public entry: lights a G-buffer of known base colour by an environment map (docs/contract.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.relight.envmap import EnvMap
from yesnt.relight.frame import finish_edges, prepare_relight, shade_pixels
from yesnt.relight.lights import PreparedLight
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import Surface, gather_pixels
from yesnt.relight.settings import Brdf, RelightSettings, Shadows

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class GBuffer:
    """Images of one frame, straight (not multiplied by opacity).

    Attributes:
        base_color: [H, W, 3] linear Rec.709, 0..1.
        roughness: [H, W] Disney r, 0..1.
        metallic: [H, W] 0..1.
        normal: [H, W, 3] unit, world.
        z: [H, W] planar metres; 0, NaN or 1e10 where nothing is.
        opacity: [H, W] coverage.
    """

    base_color: NDArray[np.floating]
    roughness: NDArray[np.floating]
    metallic: NDArray[np.floating]
    normal: NDArray[np.floating]
    z: NDArray[np.floating]
    opacity: NDArray[np.floating]


@dataclass(frozen=True)
class Shading:
    """Result of `shade`: straight images, scene-linear Rec.709, 0 where the opacity is 0.

    Attributes:
        diffuse: [H, W, 3] radiance.
        specular: [H, W, 3] radiance.
        shadow: [H, W] luminance over that without occlusion, 0..1.
        radiance: [H, W, 3] diffuse + specular.
    """

    diffuse: F32
    specular: F32
    shadow: F32
    radiance: F32


def shade(
    gbuffer: GBuffer,
    env: EnvMap,
    camera: Camera,
    quality: str | RelightSettings = "standard",
    shadows: Shadows = True,
    brdf: Brdf = "default",
    frame: int | None = None,
) -> Shading:
    """Lights a G-buffer; shadows are marched in its depth buffer.

    Args:
        gbuffer: images of one frame.
        env: the light.
        camera: pinhole camera of the size of the images.
        quality: a named quality, or settings whose `shadows` and `brdf` are replaced by the arguments.
        shadows: False: none; "single": the paper's one factor per pixel; True: one visibility per light cluster.
        brdf: "paper": the plain formula of docs/method.md section 5; "default": with the terms that match Cycles.
        frame: frame number of the camera's pose; None: the first.

    Raises:
        ValueError: an array of another shape than the camera's picture, or a dtype that is not floating point.
        JobError: a name is unknown.
    """
    check_arrays(gbuffer, camera)
    settings = RelightSettings.from_quality(quality) if isinstance(quality, str) else quality
    settings = replace(settings, shadows=shadows, brdf=brdf)
    surface = Surface(gbuffer.normal, gbuffer.z, gbuffer.opacity, gbuffer.roughness, gbuffer.metallic, camera, frame)
    pixels = gather_pixels(surface)
    base = np.asarray(gbuffer.base_color, dtype=np.float32).reshape(-1, 3)[pixels.index]
    base = np.clip(np.nan_to_num(base, nan=0.0), 0, 1)
    occluders = find_occluders(surface, pixels, None, settings)
    relit = shade_pixels(base, pixels, occluders, _prepared(env, settings), settings)
    relit = finish_edges(relit, pixels.image(base), surface, settings)
    return Shading(relit.diffuse, relit.specular, relit.shadow, relit.radiance)


_CHANNELS = {"base_color": 3, "normal": 3}
"""Components of the images that have several."""


def check_arrays(gbuffer: GBuffer, camera: Camera) -> None:
    """Refuses arrays that NumPy would stretch, cut or misread without a word.

    Raises:
        ValueError: as `shade`.
    """
    for name in GBuffer.__dataclass_fields__:
        array = np.asarray(getattr(gbuffer, name))
        shape = (camera.height, camera.width, *([_CHANNELS[name]] if name in _CHANNELS else []))
        if array.shape != shape:
            raise ValueError(
                f"gbuffer.{name} has shape {array.shape}: expected {shape}, rows and columns of the camera"
            )
        if array.dtype.kind != "f":
            raise ValueError(
                f"gbuffer.{name} has dtype {array.dtype}: expected floating point; divide 8-bit values by 255, and "
                "decode sRGB colours to linear"
            )


@lru_cache(maxsize=2)
def _prepared(env: EnvMap, settings: RelightSettings) -> PreparedLight:
    """Prepares a map once for the frames of a shot; bounded by two maps."""
    return prepare_relight(env, settings)
