"""Compiles the kernels of the evidence by measuring a tiny frame with the types that the tasks use."""

from __future__ import annotations

import numpy as np

from yesnt.core.camera import Camera
from yesnt.decompose.evidence.frame import EvidenceInputs, measure_frame
from yesnt.decompose.evidence.records import View
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight.frame import prepare_capture
from yesnt.relight.lights import uniform_light
from yesnt.relight.points import Surface
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings

SIZE = 8
"""Rows and columns of the tiny pictures."""


def precompile_evidence() -> None:
    """All kernels: responses, likelihood, gains and light, pooling, the posterior."""
    settings = RelightSettings(capture_texels=16, capture_clusters=4)
    plane = np.ones((SIZE, SIZE), np.float32)
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    normal[..., 2] = -1
    surface = Surface(normal, plane, plane, 0.5 * plane, 0 * plane, _camera(0.0), 0)
    picture = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    views = [View(str(x), _camera(x), 0, picture, plane) for x in (-0.1, 0.1)]
    # Wider than the pictures, as the mattes are full.
    proxy = ProxyScene.from_arrays([[-9, -9, 1], [9, -9, 1], [9, 9, 1], [-9, 9, 1]], [[0, 2, 1], [0, 3, 2]])
    light = prepare_capture(uniform_light(), settings)
    inputs = EvidenceInputs(picture, surface, np.full((2, SIZE, SIZE), 0.1, np.float32), views, proxy, light)
    measure_frame(inputs, settings, EvidenceSettings())


def _camera(x: float) -> Camera:
    """A camera that looks along +z from x."""
    pose = np.eye(4)
    pose[0, 3] = x
    return Camera(SIZE, SIZE, SIZE, SIZE, SIZE / 2, SIZE / 2, {0: pose})
