"""Training patches: crops of pictures, seen through different cameras. Patch n of seed s is always the same."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.global_context import CONTEXT_SIDE, Square, context_image
from yesnt.training.synthetic.light import draw_light
from yesnt.training.synthetic.materials import CLASSES, DEFAULT_STYLE, RECOLOURABLE, MaterialStyle
from yesnt.training.synthetic.render import Rendering, render
from yesnt.training.synthetic.scene import draw_scene

Float32 = NDArray[np.float32]

MARGIN = 16
"""Pixels by which a rendered picture is larger than a patch, so that crops differ."""


@dataclass(frozen=True)
class Patches:
    """Training examples; a single one lacks the first axis.

    Attributes:
        rgb: [n, 3, P, P] straight linear, 0 outside the matte.
        matte: [n, 1, P, P] coverage.
        truth: [n, 2, P, P] roughness and metallic.
        kind: [n, P, P] int64 number of the material class, -1 outside the matte.
        context: [n, 4, S, S] the picture's subject in small, straight rgb and matte.
        location: [n, 3] top, left and side of the patch, in sides of `whole`.
        context_truth: [n, 3, S/4, S/4] roughness, metallic and coverage of the subject in small.
        context_kind: [n, S/4, S/4] int64 its class, -1 outside the matte.
        auxiliary_input: [n, 4, V, V] as `whole`, larger; V = 0: not asked for.
    """

    rgb: Float32
    matte: Float32
    truth: Float32
    kind: NDArray[np.int64]
    context: Float32
    location: Float32
    context_truth: Float32
    context_kind: NDArray[np.int64]
    auxiliary_input: Float32

    def planes(self) -> tuple[NDArray[np.generic], ...]:
        """All attributes in order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @classmethod
    def stack(cls, examples: list[Patches]) -> Patches:
        """Of single examples as `crop` makes them."""
        return cls(*(np.stack(planes) for planes in zip(*(e.planes() for e in examples), strict=True)))

    @classmethod
    def join(cls, groups: list[Patches]) -> Patches:
        """One group after another."""
        return cls(*(np.concatenate(planes) for planes in zip(*(g.planes() for g in groups), strict=True)))

    def mirrored(self) -> Patches:
        """A single example with left and right exchanged."""
        top, left, side = self.location
        planes = {f.name: np.ascontiguousarray(getattr(self, f.name)[..., ::-1]) for f in fields(self)}
        return Patches(**{**planes, "location": np.array([top, 1 - left - side, side], np.float32)})

    def mixed(self, mix: Float32) -> Patches:
        """A single example in other colours, [3, 3] from the old."""
        context, auxiliary_input = (
            np.concatenate([np.einsum("ij,jyx->iyx", mix, picture[:3]), picture[3:]])
            for picture in (self.context, self.auxiliary_input)
        )
        return replace(
            self, rgb=np.einsum("ij,jyx->iyx", mix, self.rgb), context=context, auxiliary_input=auxiliary_input
        )

    def transposed(self) -> Patches:
        """A single example with rows and columns exchanged."""
        planes = {
            f.name: np.ascontiguousarray(getattr(self, f.name).swapaxes(-1, -2))
            for f in fields(self)
            if f.name != "location"
        }
        return Patches(**planes, location=self.location[[1, 0, 2]])


@dataclass(frozen=True)
class Augmentation:
    """How far pictures go beyond what is usual.

    Attributes:
        style: how stuff in heaps is coloured.
        colour_mixing: probability that an example's colours are colour_mixing: blue skin, a grey world.
        recoloured: probability that somebody's clothes take the colour of the wearer's skin, or of a metal.
    """

    style: MaterialStyle = DEFAULT_STYLE
    colour_mixing: float = 0.0
    recoloured: float = 0.0


USUAL = Augmentation()


def draw_patches(seed: int, index: int, count: int, patch: int, augmentation: Augmentation = USUAL) -> Patches:
    """SamplePairs `count` patches of heap number `index`: crops, mirrored and seen through different cameras."""
    rng = np.random.Generator(np.random.Philox(key=[seed, index]))
    picture = draw_picture(rng, patch + MARGIN, augmentation.style)
    return Patches.stack([crop(rng, picture, patch, colour_mixing=augmentation.colour_mixing) for _ in range(count)])


def draw_picture(rng: np.random.Generator, size: int, style: MaterialStyle = DEFAULT_STYLE) -> Rendering:
    """Renders one scene of size x size pixels that fills at least a fifth of it."""
    while True:
        scene = draw_scene(rng, 2 * size, style)
        if (scene.geometry.material >= 0).mean() > 0.2:
            return render(scene.geometry, scene.paints(), draw_light(rng))


def crop(
    rng: np.random.Generator,
    picture: Rendering,
    patch: int,
    shrink: float = 1.0,
    colour_mixing: float = 0.0,
    auxiliary_input: int = 0,
) -> Patches:
    """A random patch, a single example, with at least a twelfth of it inside the matte (best of ten tries).

    Args:
        rng: of place, mirroring and the camera's faults.
        picture: at least `shrink` times as large as the patch.
        patch: side P.
        shrink: the patch shows so many times its size of the picture, averaged.
        colour_mixing: probability that the colours are colour_mixing.
        auxiliary_input: side of a larger picture of the whole subject; 0: none.
    """
    side = min(round(patch * shrink), *picture.matte.shape)
    room = np.array(picture.matte.shape) - side + 1
    places = rng.integers(0, room, (10, 2))
    shares = [picture.matte[y : y + side, x : x + side].mean() for y, x in places]
    good = [k for k, share in enumerate(shares) if share > 1 / 12]
    y, x = places[good[0] if good else int(np.argmax(shares))]
    planes = _window(picture, np.s_[..., y : y + side, x : x + side], patch)
    rgb, matte, gain = expose(rng, planes[:3], planes[3])
    square = Square.around(picture.matte.astype(np.float32))
    example = Patches(
        rgb, matte[None], planes[4:6], planes[6].astype(np.int64),
        _exposed_context(picture, square, gain, CONTEXT_SIDE), np.array(square.locate(int(y), int(x), side), np.float32),
        *context_truth(picture, square, CONTEXT_SIDE // 4), _exposed_context(picture, square, gain, auxiliary_input),
    )  # fmt: skip
    if rng.random() < 0.5:
        example = example.mirrored()
    if rng.random() < 0.1:
        example = example.transposed()
    if colour_mixing > 0 and rng.random() < colour_mixing:
        example = example.mixed(draw_mix(rng))
    return example


def recolour_garments(rng: np.random.Generator, picture: Rendering) -> Rendering:
    """The picture with its cloth dyed in the wearer's colour: only shape, print and place tell a shirt from a chest.

    Each cloth's radiance is multiplied until its mean is the skin's (or a pale grey's). That dyes its faint gloss too,
    which is wrong by a few hundredths of what is seen.
    """
    names = list(CLASSES)
    whole = picture.matte > 0.99
    skin = (picture.kind == names.index("skin")) & whole
    rgb = picture.rgb.astype(np.float32)
    for name in RECOLOURABLE:
        cloth = picture.kind == names.index(name)
        if (cloth & whole).sum() < 100 or rng.random() > 0.8:
            continue
        of_skin = skin.sum() > 100 and rng.random() < 0.75
        wanted = rgb[:, skin].mean(1) if of_skin else np.full(3, rng.uniform(0.35, 0.8))
        ratio = wanted * np.exp(rng.normal(0, 0.12, 3)) / np.maximum(rgb[:, cloth & whole].mean(1), 1e-3)
        rgb = np.where(cloth, rgb * np.clip(ratio, 0.15, 4)[:, None, None].astype(np.float32), rgb)
    return replace(picture, rgb=rgb)


def draw_mix(rng: np.random.Generator) -> Float32:
    """[3, 3] new colours from old: channels exchanged, half of the time paler as well, down to grey.

    Under white light that is the picture of a world in these colours: rows sum to 1, so a white highlight stays white.
    It leaves shape, print and gloss to tell a stuff by.
    """
    strength = 1.0 if rng.random() < 0.5 else rng.random()
    return (strength * np.eye(3)[rng.permutation(3)] + (1 - strength) / 3).astype(np.float32)


def _exposed_context(picture: Rendering, square: Square, gain: Float32, side: int) -> Float32:
    """The subject in small, exposed like the patch; what noise the camera adds is averaged away."""
    if side == 0:
        return np.zeros((4, 0, 0), np.float32)
    matte = picture.matte.astype(np.float32)
    straight = picture.rgb.astype(np.float32) / np.maximum(matte, 1 / 512)
    small = context_image(straight.astype(np.float32), matte, square, side)
    return np.concatenate([small[:3] * gain[:, None, None], small[3:]]).astype(np.float32)


def context_truth(picture: Rendering, square: Square, side: int) -> tuple[Float32, NDArray[np.int64]]:
    """Roughness, metallic and coverage [3, side, side] of the subject in small, and the class."""
    matte = picture.matte.astype(np.float32)
    small = square.shrink(np.concatenate([picture.truth * matte, matte[None]]), side)
    middle = square.side * (np.arange(side) + 0.5) / side
    rows, columns = (np.floor(start + middle).astype(int) for start in (square.top, square.left))
    height, width = matte.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
    kind = picture.kind[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)]
    small[:2] /= np.maximum(small[2:], 1e-3)
    return small, np.where(inside, kind, -1).astype(np.int64)


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


def expose(rng: np.random.Generator, rgb: Float32, matte: Float32) -> tuple[Float32, Float32, Float32]:
    """The camera: blur, exposure, colour cast, shot and read noise; then the colour is made straight.

    Args:
        rng: source of the camera's faults.
        rgb: [3, P, P] associated.
        matte: [P, P].

    Returns:
        Straight rgb [3, P, P], matte [P, P], exposure and cast [3].
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
    return straight.astype(np.float32), np.where(seen, matte, 0).astype(np.float32), gain.astype(np.float32)
