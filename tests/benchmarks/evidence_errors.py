"""Errors that enter what the evidence is given and not the truth; every rung of the ladder of docs/evidence.md."""

from dataclasses import replace

import numpy as np

from yesnt.relight import EnvMap, RelightSettings
from yesnt.relight.envmap import uv_to_direction
from yesnt.relight.frame import prepare_capture

LADDER = {
    "none": {},
    "normals 5 degrees": {"degrees": 5},
    "normals 10 degrees": {"degrees": 10},
    "depth 1 %": {"depth": 0.01},
    "map 10 %": {"light": 0.1},
    "gain 5 %": {"gain": 0.05},
    "all": {"degrees": 5, "depth": 0.01, "light": 0.1, "gain": 0.05, "noise": 0.01},
}
"""Rung -> arguments of `with_errors`."""


def smooth_noise(at, scale, rng, width):
    """Smooth random fields [..., width] of unit variance over points [..., 3]."""
    waves = [(rng.normal(size=3), rng.uniform(0, 2 * np.pi), rng.normal(size=width)) for _ in range(12)]
    total = sum(np.sin(at @ (2 * np.pi / scale * k / np.linalg.norm(k)) + p)[..., None] * a for k, p, a in waves)
    return total / total.std()


def tilted(normal, degrees, rng, scale):
    """Normals [H, W, 3] turned by a smooth field of so many degrees (root of the mean square)."""
    away = np.tan(np.radians(degrees)) / np.sqrt(2) * smooth_noise(normal.astype(float), scale, rng, 3)
    turned = normal + away
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(np.linalg.norm(normal, axis=-1, keepdims=True) > 0, turned / length, 0).astype(np.float32)


def wrong_map(env, share, rng):
    """A map off by a smooth factor of so much."""
    rows, columns, _ = env.radiance.shape
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    factor = 1 + share * smooth_noise(uv_to_direction(u, v), 1.5, rng, 1)
    return EnvMap.from_array(env.radiance * np.clip(factor, 0.3, 2))


def with_errors(given, env, seed=0, *, degrees=0.0, depth=0.0, light=0.0, gain=0.0, noise=0.0):
    """The inputs of a frame with errors.

    Args:
        given: inputs without.
        env: the map that the pictures were taken under.
        seed: of the errors.
        degrees: by which normals are off.
        depth: share by which z is off, smoothly.
        light: share by which the map is off, smoothly.
        gain: share by which each camera's channels are off.
        noise: share by which each pixel is off.
    """
    rng = np.random.default_rng([seed, 18])
    surface = given.surface
    if degrees:
        surface = replace(surface, normal=tilted(surface.normal, degrees, rng, 0.5))
    if depth:
        off = 1 + depth * smooth_noise(surface.normal.astype(float), 0.5, rng, 1)[..., 0]
        surface = replace(surface, z=np.where(surface.opacity > 0, surface.z * off, surface.z).astype(np.float32))

    def spoilt(image):
        factor = np.exp(gain * rng.normal(size=3)) * (1 + noise * rng.normal(size=image.shape))
        return (image * factor).astype(np.float32)

    views = [replace(view, radiance=spoilt(view.radiance)) for view in given.views]
    found = replace(given, surface=surface, views=views, plate=spoilt(given.plate))
    return replace(found, light=prepare_capture(wrong_map(env, light, rng), RelightSettings())) if light else found
