"""Compositing in scene-linear light with associated alpha (method.md section 6; Porter and Duff 1984, "over")."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import display_decode, display_encode, luminance, straighten

Float32 = NDArray[np.float32]
Blend = Callable[[Float32, Float32], Float32]


def associate(color: Float32, opacity: Float32) -> Float32:
    """Straight colour [H, W, 3] and opacity [H, W] as associated RGBA [H, W, 4]."""
    return np.concatenate([color * opacity[..., None], opacity[..., None]], axis=-1).astype(np.float32)


class Behind(NamedTuple):
    """What is behind the subject, and what the subject does to it: with the subject it is `ratio * picture + added`.

    Attributes:
        picture: [H, W, 4] associated, without the subject.
        ratio: [H, W, 3] share of the light that the subject leaves, 0..1.
        added: [H, W, 3] radiance that the subject adds.
        holdout: [H, W] share of the pixel in which a part of the set is in front of the subject.
        front: [H, W, 3] light of these parts, associated with `holdout`; None: `picture` holds it.
    """

    picture: Float32
    ratio: Float32
    added: Float32
    holdout: Float32
    front: Float32 | None = None

    def with_subject(self) -> Float32:
        """The picture [H, W, 4] with the subject's shadow and reflection, and without the subject itself."""
        color = self.ratio * self.picture[..., :3] + self.added
        return np.concatenate([color, self.picture[..., 3:]], axis=-1).astype(np.float32)

    def shadow(self) -> Float32:
        """Luminance [H, W] that the subject leaves over that without it, 0..1; 1 where there is no light."""
        whole = luminance(np.maximum(self.picture[..., :3], 0))
        left = luminance(self.ratio * np.maximum(self.picture[..., :3], 0))
        found = np.where(whole > 0, left / np.where(whole > 0, whole, 1), luminance(self.ratio))
        untouched = (self.ratio == 1).all(axis=-1)
        return np.where(untouched, 1, np.clip(found, 0, 1)).astype(np.float32)

    def reflection(self) -> Float32:
        """What is to be added [H, W, 3] to `shadow * picture`: reflections, and the tint of the shadow."""
        return self.with_subject()[..., :3] - self.shadow()[..., None] * self.picture[..., :3]


def held_out(foreground: Float32, holdout: Float32) -> Float32:
    """An associated foreground [H, W, 4] without the share [H, W] of it that is hidden."""
    return foreground * (1 - holdout[..., None])


def into_set(relit: Float32, behind: Behind, laid: Blend | None = None) -> Float32:
    """The subject over the set behind it, and under the parts of the set in front of it.

    With `front`, `front + (1 - holdout) (relit + (1 - a) (ratio picture + added))`: an edge of such a part shows the
    subject through the rest of the pixel, and nothing of what is behind the subject.

    Args:
        relit: [H, W, 4] associated.
        behind: the set.
        laid: how one picture is laid over another; None: `over`.

    Returns:
        [H, W, 4] associated.
    """
    laid = laid or over
    background = behind.with_subject()
    background[..., :3] = np.maximum(background[..., :3], 0)  # half of a denoised difference may fall below
    if behind.front is None:
        return laid(held_out(relit, behind.holdout), background)
    before = np.concatenate([behind.front, behind.holdout[..., None]], axis=-1)
    return laid(before, laid(relit, background))


def opaque(picture: Float32) -> Float32:
    """A picture [H, W, 3] or [H, W, 4] associated as [H, W, 4]; three components count as opaque."""
    if picture.shape[-1] == 4:
        return picture
    return np.concatenate([picture, np.ones_like(picture[..., :1])], axis=-1)


def over(foreground: Float32, background: Float32) -> Float32:
    """Foreground over background: out = fg + (1 - a) bg.

    Args:
        foreground: [H, W, 4] associated.
        background: [H, W, 3] or [H, W, 4] associated; three components count as opaque.

    Returns:
        [H, W, 4] associated.
    """
    return (foreground + (1 - foreground[..., 3:]) * opaque(background)).astype(np.float32)


def over_in_display(foreground: Float32, background: Float32) -> Float32:
    """The paper's composite: `over` of code values, D(a E(f) + (1 - a) E(b)) with sRGB's curve E and its inverse D.

    The paper lays the gamma-corrected foreground over the background by its alpha. Light above 1 goes on along the
    curve instead of being cut at white. Edges differ from what a camera sees, which mixes light. What the foreground
    has where it covers nothing (flames) is added as light.

    Args:
        foreground: [H, W, 4] associated, scene-linear.
        background: [H, W, 3] or [H, W, 4] associated, scene-linear; three components count as opaque.

    Returns:
        [H, W, 4] associated, scene-linear.
    """
    back, cover = opaque(background), foreground[..., 3:]
    alpha = cover + (1 - cover) * back[..., 3:]
    code = cover * display_encode(straighten(foreground[..., :3], foreground[..., 3]))
    code = code + (1 - cover) * back[..., 3:] * display_encode(straighten(back[..., :3], back[..., 3]))
    color = display_decode(straighten(code, alpha[..., 0])) * alpha
    color = color + np.where(cover > 0, 0, foreground[..., :3]) + np.where(alpha > 0, 0, back[..., :3])
    return np.concatenate([color, alpha], axis=-1).astype(np.float32)
