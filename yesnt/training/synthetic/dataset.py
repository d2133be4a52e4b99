"""Training patches: crops of pictures, seen through different cameras. Patch n of seed s is always the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from yesnt.training.synthetic.light import draw_light
from yesnt.training.synthetic.render import Rendering, render
from yesnt.training.synthetic.scene import draw_scene

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

    @classmethod
    def stack(cls, crops: list[Float32]) -> Patches:
        """Of crops [7, P, P] as `crop` makes them."""
        planes = np.stack(crops)
        return cls(planes[:, :3], planes[:, 3:4], planes[:, 4:6], planes[:, 6].astype(np.int64))


def draw_patches(seed: int, index: int, count: int, patch: int) -> Patches:
    """Draws `count` patches of heap number `index`: crops, mirrored and seen through different cameras."""
    rng = np.random.Generator(np.random.Philox(key=[seed, index]))
    picture = draw_picture(rng, patch + MARGIN)
    return Patches.stack([crop(rng, picture, patch) for _ in range(count)])


def draw_picture(rng: np.random.Generator, size: int) -> Rendering:
    """Renders one scene of size x size pixels that fills at least a fifth of it."""
    while True:
        scene = draw_scene(rng, 2 * size)
        if (scene.geometry.material >= 0).mean() > 0.2:
            return render(scene.geometry, scene.paints(), draw_light(rng))


def crop(rng: np.random.Generator, picture: Rendering, patch: int, shrink: float = 1.0) -> Float32:
    """A random patch [rgb, matte, truth, kind] with at least a twelfth of it inside the matte (best of ten tries).

    Args:
        rng: of place, mirroring and the camera's faults.
        picture: at least `shrink` times as large as the patch.
        patch: side P.
        shrink: the patch shows so many times its size of the picture, averaged.

    Returns:
        [7, P, P].
    """
    side = min(round(patch * shrink), *picture.matte.shape)
    room = np.array(picture.matte.shape) - side + 1
    places = rng.integers(0, room, (10, 2))
    shares = [picture.matte[y : y + side, x : x + side].mean() for y, x in places]
    good = [k for k, share in enumerate(shares) if share > 1 / 12]
    y, x = places[good[0] if good else int(np.argmax(shares))]
    planes = _window(picture, np.s_[..., y : y + side, x : x + side], patch)
    rgb, matte = _expose(rng, planes[:3], planes[3])
    planes = np.concatenate([rgb, matte[None], planes[4:]])
    if rng.random() < 0.5:
        planes = planes[:, :, ::-1]
    if rng.random() < 0.1:
        planes = planes.transpose(0, 2, 1)
    return np.ascontiguousarray(planes, dtype=np.float32)


def _window(picture: Rendering, window: Any, patch: int) -> Float32:
    """A part of a picture at the patch's size: associated rgb, matte, straight truth, class."""
    matte = picture.matte[window]
    associated = [picture.rgb[window], matte[None], picture.truth[window] * matte, picture.kind[window][None]]
    planes = np.concatenate([plane.astype(np.float32) for plane in associated])
    if planes.shape[-1] != patch:
        shrunk = [cv2.resize(plane, (patch, patch), interpolation=cv2.INTER_AREA) for plane in planes[:6]]
        planes = np.stack([*shrunk, cv2.resize(planes[6], (patch, patch), interpolation=cv2.INTER_NEAREST)])
    planes[4:6] /= np.maximum(planes[3], 1e-3)
    return planes


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
