"""Procedural environment maps: lat-long radiance in Blender's mapping (method.md section 1)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.io.exr import write_exr

Radiance = NDArray[np.float32]
Vector = tuple[float, float, float]
Color = tuple[float, float, float]

SUN_DIRECTION: Vector = (-0.62, -0.52, 0.60)
"""Towards the sun: from the camera's left and somewhat in front of a subject that faces -Y."""

SUN_RADIUS_DEGREES = 0.75
SUN_RADIANCE = 11000.0
HALF_MAX = 65504.0


def directions(height: int, width: int) -> NDArray[np.float64]:
    """World directions through texel centres, [h, w, 3]; row 0 is up, the centre column looks along +X."""
    azimuth = (0.5 - (np.arange(width) + 0.5) / width) * 2 * np.pi
    polar = (np.arange(height) + 0.5) / height * np.pi
    sine = np.sin(polar)[:, None]
    up = np.broadcast_to(np.cos(polar)[:, None], (height, width))
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), up], axis=-1)


def capture(height: int = 128, width: int = 256) -> Radiance:
    """The light a volumetric stage is shot under: nearly uniform, gently brighter above, four large soft panels."""
    d = directions(height, width)
    base = 0.82 + 0.10 * d[..., 2]
    for toward, gain in (((-1, -1, 0.5), 0.40), ((1, -1, 0.5), 0.40), ((0, 1, 0.6), 0.30), ((0, -1, -0.3), 0.15)):
        base = base + gain * _lobe(d, toward, sharpness=6.0)
    return np.repeat(base[..., None], 3, axis=-1).astype(np.float32)


def sky(height: int = 256, width: int = 512) -> Radiance:
    """A clear sky over dry ground; the sun is a disc of a few texels, over 10^4 times as bright as the mean."""
    d = directions(height, width)
    up = d[..., 2:]
    above = np.clip(up, 0, 1) ** 0.45
    blue = (1 - above) * np.array([0.62, 0.66, 0.70]) + above * np.array([0.10, 0.21, 0.47])
    haze = 1.1 * _lobe(d, SUN_DIRECTION, 40.0)[..., None] * np.array([1.0, 0.86, 0.66])
    ground = np.array([0.15, 0.125, 0.095]) * (1 + 0.15 * np.sin(9 * np.arctan2(d[..., 1:2], d[..., :1])))
    horizon = 1 / (1 + np.exp(-np.clip(up * 90, -50, 50)))
    out = horizon * (blue + haze) + (1 - horizon) * ground
    return (out + _sun(height, width)).astype(np.float32)


def studio(height: int = 256, width: int = 512) -> Radiance:
    """A dark room: a warm key, a cool rim from behind, a strip overhead, a weak fill and a floor kicker."""
    d = directions(height, width)
    out = np.broadcast_to(np.array([0.035, 0.037, 0.042]), (height, width, 3)) * (1.3 + d[..., 2:])
    boxes: tuple[tuple[Vector, float, float, Color], ...] = (
        ((0.80, -0.85, 0.55), 24, 18, (9.0, 6.8, 4.6)),
        ((-0.75, 0.80, 0.50), 9, 30, (5.5, 8.8, 14.0)),
        ((0.10, -0.15, 1.00), 34, 10, (3.4, 3.4, 3.4)),
        ((-1.00, -0.55, 0.15), 20, 26, (1.0, 1.1, 1.25)),
        ((0.20, -1.00, -0.55), 26, 7, (1.3, 1.0, 0.8)),
    )
    for toward, half_width, half_height, color in boxes:
        out = out + _softbox(d, toward, half_width, half_height)[..., None] * np.array(color)
    return out.astype(np.float32)


SMOOTH_RADIANCE = (0.25, 1.58)
"""Least and largest radiance of the smooth directional light."""

_SMOOTH_TERMS: tuple[tuple[float, Callable[[NDArray[np.float64]], NDArray[np.float64]]], ...] = (
    (0.55, lambda d: d[..., 2]), (-0.75, lambda d: d[..., 1]), (-0.45, lambda d: d[..., 0]),
    (0.60, lambda d: d[..., 0] * d[..., 1]), (0.35, lambda d: d[..., 1] * d[..., 2]),
    (-0.30, lambda d: d[..., 0] ** 2 - d[..., 1] ** 2), (0.25, lambda d: 3 * d[..., 2] ** 2 - 1),
    (0.60, lambda d: d[..., 0] * (d[..., 0] ** 2 - 3 * d[..., 1] ** 2)),
    (0.90, lambda d: d[..., 0] * d[..., 1] * d[..., 2]), (-0.30, lambda d: d[..., 1] * (5 * d[..., 2] ** 2 - 1)),
)  # fmt: skip
"""Weights of real spherical harmonics of degree 1 to 3, up to their norms: chosen once, of mixed directions."""


def smooth(height: int = 128, width: int = 256) -> Radiance:
    """A smooth directional light: spherical harmonics to degree 3, scaled to `SMOOTH_RADIANCE`."""
    d = directions(height, width)
    value = np.sum([weight * term(d) for weight, term in _SMOOTH_TERMS], axis=0)
    least, most = SMOOTH_RADIANCE
    scaled = least + (most - least) * (value - value.min()) / (value.max() - value.min())
    return np.repeat(scaled[..., None], 3, axis=-1).astype(np.float32)


OWN_MAPS: dict[str, Callable[[], Radiance]] = {"capture": capture, "smooth": smooth, "sky": sky, "studio": studio}
"""Maps that need nothing fetched, by the name that `truth/relit_NAME` carries."""


def write_map(path: Path, radiance: Radiance) -> None:
    """Writes a map as an EXR of half, or of float where a value does not fit half."""
    dtype = np.float16 if radiance.max() < HALF_MAX else np.float32
    write_exr(path, {name: radiance[..., i].astype(dtype) for i, name in enumerate("RGB")})


def reduce_by_two(radiance: Radiance) -> Radiance:
    """Means of 2x2 texels: keeps radiance and directions (texel edges stay on texel edges)."""
    h, w, c = radiance.shape
    return radiance.reshape(h // 2, 2, w // 2, 2, c).mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def _unit(v: Vector) -> NDArray[np.float64]:
    return np.asarray(v, dtype=np.float64) / np.linalg.norm(v)


def _lobe(d: NDArray[np.float64], toward: Vector, sharpness: float) -> NDArray[np.float64]:
    """A spherical Gaussian of peak 1."""
    return np.exp(sharpness * (d @ _unit(toward) - 1))


def _softbox(d: NDArray[np.float64], toward: Vector, half_width: float, half_height: float) -> NDArray[np.float64]:
    """A rectangle in degrees about a direction, soft over a fifth of its size."""
    axis = _unit(toward)
    right = np.cross(axis, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    above = np.cross(right, axis)
    forward = d @ axis
    x = np.degrees(np.arctan2(d @ right, forward)) / half_width
    y = np.degrees(np.arctan2(d @ above, np.hypot(forward, d @ right))) / half_height
    edge = np.clip((1.1 - np.maximum(np.abs(x), np.abs(y))) / 0.2, 0, 1)
    return edge * edge * (3 - 2 * edge) * (forward > 0)


def _sun(height: int, width: int, oversample: int = 4) -> NDArray[np.float64]:
    """The disc, averaged over each texel's area so that its energy does not depend on where the grid falls."""
    fine = directions(height * oversample, width * oversample)
    inside = fine @ _unit(SUN_DIRECTION) > np.cos(np.radians(SUN_RADIUS_DEGREES))
    share = inside.reshape(height, oversample, width, oversample).mean(axis=(1, 3))
    return SUN_RADIANCE * share[..., None] * np.array([1.0, 0.90, 0.74])
