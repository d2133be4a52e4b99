"""Silhouettes of balls by cameras around them, and a rig of such cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.decompose.evidence.scenes import FRAME, look_from
from yesnt.capture.hull import Silhouette

ONE_BALL = (((0.0, 0.0, 0.0), 1.0),)


def ring(count, elevation=10.0):
    """Directions at one elevation, degrees."""
    azimuth, up = np.linspace(0, 2 * np.pi, count, endpoint=False), np.radians(elevation)
    return [np.array([np.cos(a) * np.cos(up), np.sin(a) * np.cos(up), np.sin(up)]) for a in azimuth]


def around_balls(count):
    """Directions at three elevations, as on the stage."""
    return [*ring(count // 2), *ring(count // 4, 45), *ring(count // 4, -25)]


def coverage(camera, balls=ONE_BALL, samples=4):
    """Share [H, W] of each pixel that balls (centre, radius) cover."""
    size = {key: getattr(camera, key) * samples for key in ("width", "height", "fx", "fy", "cx", "cy")}
    fine = replace(camera, **size)
    rays, eye = fine.rays(FRAME).astype(float), fine.position(FRAME)
    way = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    hit = np.zeros(way.shape[:2], bool)
    for centre, radius in balls:
        away = np.asarray(centre) - eye
        hit |= (way @ away > 0) & (away @ away - (way @ away) ** 2 < radius**2)
    return hit.reshape(camera.height, samples, camera.width, samples).mean((1, 3)).astype(np.float32)


def silhouettes(directions, size=96, balls=ONE_BALL, distance=4.0):
    """What cameras from these directions see of balls."""
    cameras = [look_from(way, size, distance) for way in directions]
    return [Silhouette(f"c{i:02d}", c, FRAME, coverage(c, balls)) for i, c in enumerate(cameras)]
