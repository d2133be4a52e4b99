"""Training patches: augmented crops of renderings with ground truth. Patch n of seed s is always the same."""

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
"""Pixels by which a rendered image exceeds a patch, so that crops differ."""


@dataclass(frozen=True)
class Patches:
    """Training examples; a single example lacks the first axis.

    Attributes:
        rgb: [n, 3, P, P] straight linear, 0 outside the matte.
        matte: [n, 1, P, P] coverage in [0, 1].
        truth: [n, 2, P, P] roughness and metallic in [0, 1].
        kind: [n, P, P] int64 material class, -1 outside the matte.
        context: [n, 4, S, S] straight rgb and matte of the whole subject.
        location: [n, 3] top, left and side of the patch in units of the side of the context's square.
        context_truth: [n, 3, S/4, S/4] roughness, metallic and coverage of the subject.
        context_kind: [n, S/4, S/4] int64 material class, -1 outside the matte.
        auxiliary_input: [n, 4, V, V] like `context` at the size that the auxiliary predictor takes; V = 0: not
            requested.
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
        """Returns all attributes in order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @classmethod
    def stack(cls, examples: list[Patches]) -> Patches:
        """Stacks single examples that `crop` returned."""
        return cls(*(np.stack(planes) for planes in zip(*(e.planes() for e in examples), strict=True)))

    @classmethod
    def join(cls, groups: list[Patches]) -> Patches:
        """Concatenates groups of examples."""
        return cls(*(np.concatenate(planes) for planes in zip(*(g.planes() for g in groups), strict=True)))

    def mirrored(self) -> Patches:
        """Returns a single example mirrored horizontally."""
        top, left, side = self.location
        planes = {f.name: np.ascontiguousarray(getattr(self, f.name)[..., ::-1]) for f in fields(self)}
        return Patches(**{**planes, "location": np.array([top, 1 - left - side, side], np.float32)})

    def mixed(self, mix: Float32) -> Patches:
        """Returns a single example with colours multiplied by a matrix [3, 3]."""
        context, auxiliary_input = (
            np.concatenate([np.einsum("ij,jyx->iyx", mix, image[:3]), image[3:]])
            for image in (self.context, self.auxiliary_input)
        )
        return replace(
            self, rgb=np.einsum("ij,jyx->iyx", mix, self.rgb), context=context, auxiliary_input=auxiliary_input
        )

    def transposed(self) -> Patches:
        """Returns a single example with rows and columns exchanged."""
        planes = {
            f.name: np.ascontiguousarray(getattr(self, f.name).swapaxes(-1, -2))
            for f in fields(self)
            if f.name != "location"
        }
        return Patches(**planes, location=self.location[[1, 0, 2]])


@dataclass(frozen=True)
class Augmentation:
    """Strength of the colour augmentation.

    Attributes:
        style: colour and print statistics of materials in synthetic scenes.
        colour_mixing: probability that the colours of an example are mixed (`draw_mix`).
        recoloured: probability that garments take the colour of skin or light grey (`recolour_garments`).
    """

    style: MaterialStyle = DEFAULT_STYLE
    colour_mixing: float = 0.0
    recoloured: float = 0.0


USUAL = Augmentation()


def draw_patches(seed: int, index: int, count: int, patch: int, augmentation: Augmentation = USUAL) -> Patches:
    """Draws `count` augmented patches of one synthetic scene.

    Args:
        seed: seed of the training.
        index: number of the scene.
        count: number of patches.
        patch: side P in pixels.
        augmentation: colour augmentation.
    """
    rng = np.random.Generator(np.random.Philox(key=[seed, index]))
    image = draw_image(rng, patch + MARGIN, augmentation.style)
    return Patches.stack([crop(rng, image, patch, colour_mixing=augmentation.colour_mixing) for _ in range(count)])


def draw_image(rng: np.random.Generator, size: int, style: MaterialStyle = DEFAULT_STYLE) -> Rendering:
    """Renders a random scene of size x size pixels that covers at least a fifth of the image.

    Args:
        rng: source of every choice.
        size: side in pixels.
        style: colour and print statistics of the materials.
    """
    while True:
        scene = draw_scene(rng, 2 * size, style)
        if (scene.geometry.material >= 0).mean() > 0.2:
            return render(scene.geometry, scene.paints(), draw_light(rng))


def crop(
    rng: np.random.Generator,
    image: Rendering,
    patch: int,
    shrink: float = 1.0,
    colour_mixing: float = 0.0,
    auxiliary_input: int = 0,
) -> Patches:
    """Draws a random patch, at least a twelfth of it inside the matte (the best of ten tries otherwise).

    Args:
        rng: source of location, mirroring and camera degradation.
        image: rendering at least `shrink` times as large as the patch.
        patch: side P in pixels.
        shrink: factor by which the shown region exceeds the side of the patch; it is averaged down.
        colour_mixing: probability that the colours are mixed.
        auxiliary_input: side of the input of the auxiliary predictor; 0: none.

    Returns:
        A single example.
    """
    side = min(round(patch * shrink), *image.matte.shape)
    room = np.array(image.matte.shape) - side + 1
    places = rng.integers(0, room, (10, 2))
    shares = [image.matte[y : y + side, x : x + side].mean() for y, x in places]
    good = [k for k, share in enumerate(shares) if share > 1 / 12]
    y, x = places[good[0] if good else int(np.argmax(shares))]
    planes = _window(image, np.s_[..., y : y + side, x : x + side], patch)
    rgb, matte, gain = expose(rng, planes[:3], planes[3])
    square = Square.around(image.matte.astype(np.float32))
    example = Patches(
        rgb, matte[None], planes[4:6], planes[6].astype(np.int64),
        _exposed_context(image, square, gain, CONTEXT_SIDE), np.array(square.locate(int(y), int(x), side), np.float32),
        *context_truth(image, square, CONTEXT_SIDE // 4), _exposed_context(image, square, gain, auxiliary_input),
    )  # fmt: skip
    if rng.random() < 0.5:
        example = example.mirrored()
    if rng.random() < 0.1:
        example = example.transposed()
    if colour_mixing > 0 and rng.random() < colour_mixing:
        example = example.mixed(draw_mix(rng))
    return example


def recolour_garments(rng: np.random.Generator, image: Rendering) -> Rendering:
    """Multiplies the radiance of garments so that their mean colour is that of the skin, or a light grey.

    Shape, print and location then have to tell a shirt from skin. The tint also applies to the specular part, which is
    wrong by a few hundredths of the radiance for cloth.

    Args:
        rng: source of every choice.
        image: rendering to change; the ground truth stays.
    """
    names = list(CLASSES)
    whole = image.matte > 0.99
    skin = (image.kind == names.index("skin")) & whole
    rgb = image.rgb.astype(np.float32)
    for name in RECOLOURABLE:
        cloth = image.kind == names.index(name)
        if (cloth & whole).sum() < 100 or rng.random() > 0.8:
            continue
        of_skin = skin.sum() > 100 and rng.random() < 0.75
        wanted = rgb[:, skin].mean(1) if of_skin else np.full(3, rng.uniform(0.35, 0.8))
        ratio = wanted * np.exp(rng.normal(0, 0.12, 3)) / np.maximum(rgb[:, cloth & whole].mean(1), 1e-3)
        rgb = np.where(cloth, rgb * np.clip(ratio, 0.15, 4)[:, None, None].astype(np.float32), rgb)
    return replace(image, rgb=rgb)


def draw_mix(rng: np.random.Generator) -> Float32:
    """Draws a colour matrix [3, 3]: a permutation of the channels, half of the time blended with their mean.

    Rows sum to 1, so a white highlight stays white and the result is a plausible image under white light. Shape, print
    and gloss remain as cues of the material.
    """
    strength = 1.0 if rng.random() < 0.5 else rng.random()
    return (strength * np.eye(3)[rng.permutation(3)] + (1 - strength) / 3).astype(np.float32)


def _exposed_context(image: Rendering, square: Square, gain: Float32, side: int) -> Float32:
    """Context image of the subject with the exposure of the patch; camera noise is averaged out and omitted."""
    if side == 0:
        return np.zeros((4, 0, 0), np.float32)
    matte = image.matte.astype(np.float32)
    straight = image.rgb.astype(np.float32) / np.maximum(matte, 1 / 512)
    small = context_image(straight.astype(np.float32), matte, square, side)
    return np.concatenate([small[:3] * gain[:, None, None], small[3:]]).astype(np.float32)


def context_truth(image: Rendering, square: Square, side: int) -> tuple[Float32, NDArray[np.int64]]:
    """Computes the ground truth over the square of the context.

    Args:
        image: rendering of the subject.
        square: region to show.
        side: side of the result.

    Returns:
        Roughness, metallic and coverage [3, side, side], and material class [side, side], -1 outside the matte.
    """
    matte = image.matte.astype(np.float32)
    small = square.resample(np.concatenate([image.truth * matte, matte[None]]), side)
    middle = square.side * (np.arange(side) + 0.5) / side
    rows, columns = (np.floor(start + middle).astype(int) for start in (square.top, square.left))
    height, width = matte.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
    kind = image.kind[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)]
    small[:2] /= np.maximum(small[2:], 1e-3)
    return small, np.where(inside, kind, -1).astype(np.int64)


def _window(image: Rendering, window: Any, patch: int) -> Float32:
    """Part of an image at the size of the patch: associated rgb, matte, straight truth, class."""
    matte = image.matte[window]
    associated = [image.rgb[window], matte[None], image.truth[window] * matte, image.kind[window][None]]
    planes = np.concatenate([plane.astype(np.float32) for plane in associated])
    if planes.shape[-1] != patch:
        shrunk = [cv2.resize(plane, (patch, patch), interpolation=cv2.INTER_AREA) for plane in planes[:6]]
        planes = np.stack([*shrunk, cv2.resize(planes[6], (patch, patch), interpolation=cv2.INTER_NEAREST)])
    planes[4:6] /= np.maximum(planes[3], 1e-3)
    return planes


def expose(rng: np.random.Generator, rgb: Float32, matte: Float32) -> tuple[Float32, Float32, Float32]:
    """Degrades an image like a camera: blur, exposure, colour cast, shot and read noise; then unpremultiplies it.

    Args:
        rng: source of the degradation.
        rgb: [3, P, P] associated linear colour.
        matte: [P, P] coverage.

    Returns:
        Straight rgb [3, P, P], matte [P, P], and the factor of exposure and cast [3].
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
