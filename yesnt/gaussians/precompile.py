"""Compiles the kernels of Gaussian fields by fitting, rendering and meshing a tiny one with the types the tasks use."""

from __future__ import annotations

import numpy as np

from yesnt.core.camera import Camera
from yesnt.gaussians.fit import fit
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.initial import discs
from yesnt.gaussians.losses import LossWeights
from yesnt.gaussians.mesh import extract_mesh
from yesnt.gaussians.mesh_settings import MeshSettings
from yesnt.gaussians.records import View
from yesnt.gaussians.render import render
from yesnt.gaussians.settings import FitSettings
from yesnt.gaussians.targets import Target

SIZE, DISCS = 16, 60


def precompile_fit() -> None:
    """All kernels: projection, tiles, compositing, their gradients, the losses, Adam, the level set."""
    cameras = [_camera(side) for side in (-1.0, 1.0)]
    plane = np.ones((SIZE, SIZE), np.float32)
    color = np.full((SIZE, SIZE, 3), 0.4, np.float32)
    targets = [Target(View.of(camera), color, plane, float(plane.sum())) for camera in cameras]
    points = _sphere()
    start = discs(0.3 * points, points, targets, DISCS, degree=1)
    state = FitState.of(start, 0.6, 0.05)
    weights = LossWeights(distortion=1.0, depth=1.0, normal=1.0)
    settings = FitSettings(steps=4, half=0.5, geometry_from=0, every=2, check=2, weights=weights)
    for _ in fit(state, targets, targets, settings):
        pass
    render(state.gaussians, cameras[0])
    extract_mesh(start, [(camera, None) for camera in cameras], MeshSettings(bisections=1))


def _sphere() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Points evenly spread over the unit sphere."""
    index = np.arange(DISCS) + 0.5
    polar, turn = np.arccos(1 - 2 * index / DISCS), np.pi * (1 + np.sqrt(5)) * index
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def _camera(side: float) -> Camera:
    """A camera on the y axis that looks at the origin."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[side, 0, 0], [0, 0, side], [0, -1, 0]])
    pose[1, 3] = -side
    return Camera(SIZE, SIZE, SIZE, SIZE, SIZE / 2, SIZE / 2, {0: pose})
