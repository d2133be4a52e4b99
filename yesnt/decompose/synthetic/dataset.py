"""Training patches, made on the fly: patch n of seed s is always the same picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.synthetic.light import draw_light
from yesnt.decompose.synthetic.render import Rendering, render
from yesnt.decompose.synthetic.scene import draw_scene

Float32 = NDArray[np.float32]

MARGIN = 16
"""Pixels by which a rendered picture is larger than a patch, so that crops differ."""


@dataclass(frozen=True)
class Patches:
    """Training examples.

    Attributes:
        rgb: [n, 3, P, P] straight linear, 0 outside the matte.
        matte: [n, 1, P, P] coverage.
        truth: [n, 2, P, P] roughness and metallic.
        kind: [n, P, P] int64 number of the material class, -1 outside the matte.
    """

    rgb: Float32
    matte: Float32
    truth: Float32
    kind: NDArray[np.int64]

    def planes(self) -> tuple[NDArray[np.generic], ...]:
        """rgb, matte, truth, kind."""
        return self.rgb, self.matte, self.truth, self.kind


def draw_patches(seed: int, index: int, count: int, patch: int) -> Patches:
    """Draws `count` patches of picture number `index`: crops, mirrored and seen through different cameras."""
    rng = np.random.Generator(np.random.Philox(key=[seed, index]))
    picture = draw_picture(rng, patch + MARGIN)
    crops = [_crop(rng, picture, patch) for _ in range(count)]
    planes = np.stack(crops)
    return Patches(planes[:, :3], planes[:, 3:4], planes[:, 4:6], planes[:, 6].astype(np.int64))


def draw_picture(rng: np.random.Generator, size: int) -> Rendering:
    """Renders one scene of size x size pixels that fills at least a fifth of it."""
    while True:
        scene = draw_scene(rng, 2 * size)
        if (scene.geometry.material >= 0).mean() > 0.2:
            return render(scene.geometry, scene.paints(), draw_light(rng))


def _crop(rng: np.random.Generator, picture: Rendering, patch: int) -> Float32:
    """A random patch [rgb, matte, truth, kind] with at least a twelfth of it inside the matte (best of ten tries)."""
    places = rng.integers(0, MARGIN + 1, (10, 2))
    shares = [picture.matte[y : y + patch, x : x + patch].mean() for y, x in places]
    good = [k for k, share in enumerate(shares) if share > 1 / 12]
    y, x = places[good[0] if good else int(np.argmax(shares))]
    window = np.s_[..., y : y + patch, x : x + patch]
    rgb, matte = _expose(rng, picture.rgb[window].copy(), picture.matte[window].copy())
    planes = np.concatenate([rgb, matte[None], picture.truth[window], picture.kind[None][window]])
    if rng.random() < 0.5:
        planes = planes[:, :, ::-1]
    if rng.random() < 0.15:
        planes = planes.transpose(0, 2, 1)
    return np.ascontiguousarray(planes, dtype=np.float32)


def _expose(rng: np.random.Generator, rgb: Float32, matte: Float32) -> tuple[Float32, Float32]:
    """The camera: blur, exposure, colour cast, shot and read noise; then the colour is made straight.

    Args:
        rng: source of the camera's faults.
        rgb: [3, P, P] associated.
        matte: [P, P].
    """
    sigma = rng.uniform(0, 0.9) if rng.random() < 0.6 else 0.0
    if sigma > 0.3:
        blurred = [cv2.GaussianBlur(plane, (0, 0), sigma) for plane in (*rgb, matte)]
        rgb, matte = np.stack(blurred[:3]), blurred[3]
    gain = np.exp2(rng.normal(-0.1, 0.4)) * np.exp(rng.normal(0, 0.07, 3))
    rgb = rgb * gain[:, None, None]
    if rng.random() < 0.7:
        read, shot = np.exp(rng.uniform(np.log(3e-4), np.log(8e-3))), np.exp(rng.uniform(np.log(1e-3), np.log(2e-2)))
        rgb = rgb + rng.standard_normal(rgb.shape) * np.sqrt(read**2 + shot**2 * np.maximum(rgb, 0))
    seen = matte > 1 / 512
    straight = np.where(seen, np.maximum(rgb, 0) / np.where(seen, matte, 1), 0)
    return straight.astype(np.float32), np.where(seen, matte, 0).astype(np.float32)
