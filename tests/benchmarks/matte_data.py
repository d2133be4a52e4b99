"""A recording made of a `multiview` set: its cameras before structured backgrounds, with noise and changes of light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.benchmarks.gaussian_data import cameras_of
from yesnt.capture.hull import Silhouette
from yesnt.core.camera import Camera
from yesnt.core.color import srgb_decode, srgb_encode
from yesnt.io.pictures.image import read_image

NOISE, LIGHT, SHADOW = 0.01, 0.05, 0.6
"""Deviation of the noise, of the range of code values; largest change of the light; the cast shadow's factor."""

COLORS = ((0.5, 0.3, 0.2), (0.05, 0.05, 0.06), (0.1, 0.2, 0.5), (0.7, 0.7, 0.68), (0.3, 0.1, 0.1))
"""Of boxes in the background: skin, black, blue, white, red."""


@dataclass
class Recorded:
    """One camera: pictures by moment, pictures of a take in which the subject walks through, the clean plate, truth."""

    name: str
    camera: Camera
    pictures: np.ndarray  # [T, H, W, 3] linear
    walking: np.ndarray  # [N, H, W, 3] linear
    clean: np.ndarray  # [H, W, 3] linear
    truth: np.ndarray  # [T, H, W] coverage

    def silhouette(self, matte) -> Silhouette:
        return Silhouette(self.name, self.camera, None, matte)


def background_of(shape, rng) -> np.ndarray:
    """Walls, a floor, boards, boxes and stripes, some of them in the colours of skin and clothes."""
    height, width = shape
    y, x = np.mgrid[:height, :width] / np.array([height, width]).reshape(2, 1, 1)
    wall = np.array([0.45, 0.42, 0.4]) * (0.8 + 0.4 * x[..., None])
    picture = np.where((y > 0.62 + 0.05 * np.sin(9 * x))[..., None], np.array([0.12, 0.13, 0.15]), wall)
    for _ in range(14):
        top, left = rng.uniform(0, 0.8, 2)
        tall, wide = rng.uniform(0.05, 0.35, 2)
        color = rng.choice(
            np.array([[0.5, 0.3, 0.2], [0.05, 0.05, 0.06], [0.1, 0.2, 0.5], [0.7, 0.7, 0.68], [0.3, 0.1, 0.1]])
        )
        box = (y > top) & (y < top + tall) & (x > left) & (x < left + wide)
        stripes = 1 + 0.3 * np.sign(np.sin(x * rng.uniform(40, 160) + y * rng.uniform(-80, 80))) * rng.integers(0, 2)
        picture = np.where(box[..., None], color * stripes[..., None], picture)
    return picture.astype(np.float32)


def recorded(folder: Path, frames=(1001, 1002, 1003, 1004), count: int | None = None) -> list[Recorded]:
    """The cameras of a set before backgrounds of their own; the same for every call."""
    found = []
    cameras = cameras_of(folder / "cameras.json")
    for number, (name, camera) in enumerate(list(cameras.items())[:count]):
        rng = np.random.default_rng(number)
        behind = background_of((camera.height, camera.width), rng)
        shots = [read_image(folder / "capture" / name / f"plate.{f}.exr").stack("RGBA") for f in frames]
        pictures = [photographed(over(shot, behind), rng) for shot in shots]
        side = camera.width // 3
        moves = [
            (-side, 0),
            (side, 0),
            (-side, 8),
            (side, -8),
            (-side - 9, 4),
            (side + 9, 4),
            (-side + 7, 0),
            (side - 5, 0),
        ]
        walking = [
            *pictures,
            *(photographed(over(shifted(shots[i % len(shots)], *m), behind), rng) for i, m in enumerate(moves)),
        ]
        truth = np.stack([np.clip(shot[..., 3], 0, 1) for shot in shots]).astype(np.float32)
        found.append(Recorded(name, camera, np.stack(pictures), np.stack(walking), photographed(behind, rng), truth))
    return found


def moves(side: int) -> list[tuple[int, int]]:
    """Where else the subject stands in eight pictures of the take: pixels to the right and down."""
    right = (-side, side, -side, side, -side - 9, side + 9, -side + 7, side - 5)
    return list(zip(right, (0, 0, 8, -8, 4, 4, 0, 0), strict=True))


def shifted(rgba, right, down):
    """A picture moved by whole pixels; what leaves it is lost."""
    moved = np.roll(rgba, (down, right), (0, 1))
    moved[:, slice(0, right) if right > 0 else slice(right, None)] = 0
    return moved


def over(rgba, behind) -> np.ndarray:
    """The subject over a background on which it casts a soft shadow."""
    import cv2

    alpha = np.clip(rgba[..., 3:], 0, 1)
    shade = cv2.GaussianBlur(np.roll(alpha[..., 0], (4, 10), (0, 1)), (0, 0), 5)[..., None]
    return rgba[..., :3] + (1 - alpha) * behind * (1 - (1 - SHADOW) * shade)


def photographed(radiance, rng) -> np.ndarray:
    """Linear radiance as an 8-bit camera brings it: the light a few percent off, with noise."""
    lit = radiance * (1 + rng.uniform(-LIGHT, LIGHT))
    noisy = srgb_encode(np.clip(lit, 0, 1)) + NOISE * rng.normal(size=radiance.shape)
    return srgb_decode(np.rint(255 * np.clip(noisy, 0, 1)) / 255).astype(np.float32)


def reduced_rig(cameras: list[Recorded], count: int) -> list[Recorded]:
    """Cameras spread evenly over those of a rig."""
    return [cameras[int(i * len(cameras) / count)] for i in range(count)]
