"""Compiles the kernels of relighting by shading a tiny frame with the types that the tasks use."""

from __future__ import annotations

import numpy as np

from yesnt.core.camera import Camera
from yesnt.relight.edges import resolve_edges
from yesnt.relight.indirect import ShownPixels, indirect_light
from yesnt.relight.kernels import sum_lobes
from yesnt.relight.lights import PreparedLight, prepare_light, uniform_light
from yesnt.relight.occlusion import find_occluders, occlusion
from yesnt.relight.points import Surface, gather_pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.sparse import bands

SIZE = 4
"""Rows and columns of the tiny frame."""


def precompile_lobes() -> None:
    """Kernels of the lobe sums: kernels.py, lobes.py, texel_lod.py, irradiance.py. Nearly all of the compile time."""
    pixels = gather_pixels(_tiny_surface())
    sum_lobes(pixels.lobes(slice(0, SIZE), "default"), _tiny_light(), None, None)


def precompile_shadows() -> None:
    """Kernels of shadow rays and indirect light from a proxy, of the march without one, and of mixed pixels."""
    surface, light, settings = _tiny_surface(), _tiny_light(), RelightSettings(march_steps=2)
    pixels = gather_pixels(surface)
    base = np.ones((len(pixels.index), 3), np.float32)
    # Two triangles: NumPy calls every view of a single element contiguous, and Numba compiles once per memory layout.
    quad = ProxyScene.from_arrays([[-9, -9, 2], [9, -9, 2], [9, 9, 2], [-9, 9, 2]], [[0, 1, 2], [0, 2, 3]])
    band = bands(pixels, settings.tile)[0]
    for proxy in (quad, None):
        occluders = find_occluders(surface, pixels, proxy, settings)
        indirect = (
            None
            if proxy is None
            else indirect_light(proxy, ShownPixels(pixels, occluders.shown, base), light, settings)
        )
        occlusion(occluders, pixels, band, light, indirect, settings)
    averaged = 0.5 * surface.normal  # short normals mark pixels that mix two surfaces
    image = np.ones((SIZE, SIZE, 3), np.float32)
    resolve_edges(np.stack([image, image]), image, averaged, surface.metallic, surface.opacity > 0)


def _tiny_surface() -> Surface:
    """A plane at z = 1 that faces the camera; a dielectric, so that indirect light needs no lobe sums."""
    camera = Camera(SIZE, SIZE, SIZE, SIZE, SIZE / 2, SIZE / 2, {0: np.eye(4)})
    plane = np.ones((SIZE, SIZE), np.float32)
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    normal[..., 2] = -1
    return Surface(normal, plane, plane, 0.5 * plane, 0 * plane, camera, 0)


def _tiny_light() -> PreparedLight:
    return prepare_light(uniform_light(), 16, 4)
