"""A keyframe's estimate carried along the flow to a frame before it, so that little must be drawn there.

Flow leads from a frame to the next, so a frame between keyframes takes from the keyframe after it: it looks its own
pixels up there, with the same warp that the temporal energy uses. Which frames are keyframes follows from their
positions alone, hence every frame's result depends on its key and not on who was computed first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from yesnt.decompose.confidence import LARGEST_STD, confidence
from yesnt.decompose.settings import EnsembleSettings
from yesnt.temporal.flow import sample_next

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Prior:
    """What is known of a frame before anything is drawn; planes are (roughness, metallic).

    Attributes:
        mean: [2, H, W].
        std: [2, H, W] of the members that the mean was made of.
        known: [H, W] where the two above mean anything.
    """

    mean: Float32
    std: Float32
    known: Mask


@dataclass(frozen=True)
class Link:
    """The way from one frame to the next.

    Attributes:
        flow: [H, W, 2] pixels (dx, dy), t -> t+1.
        validity: [H, W] in [0, 1].
    """

    flow: Float32
    validity: Float32


def propagate_keyframe(
    mean: Float32, std: Float32, links: Sequence[Link], mattes: Sequence[Mask], settings: EnsembleSettings
) -> Prior:
    """The keyframe's estimate at the pixels of an earlier frame.

    Args:
        mean: [2, H, W] of the keyframe.
        std: [2, H, W] of the keyframe.
        links: from the earlier frame to the keyframe, in order of time; at least one.
        mattes: [H, W] bool of every frame from the earlier one to the keyframe: one more than links.
        settings: thresholds of validity and confidence.
    """
    flow, validity = links[-1].flow, links[-1].validity
    for link, now, then in zip(links[-2::-1], mattes[-3::-1], mattes[-2::-1], strict=False):
        onward, seen = sample_next(np.concatenate([flow, validity[..., None]], axis=-1), link.flow, now, then)
        flow, validity = link.flow + onward[..., :2], link.validity * onward[..., 2] * seen
    planes, seen = sample_next(np.concatenate([mean, std]).transpose(1, 2, 0), flow, mattes[0], mattes[-1])
    carried = planes.transpose(2, 0, 1)
    sure = confidence(carried[2:], LARGEST_STD).min(axis=0) >= settings.reuse_confidence
    return Prior(carried[:2], carried[2:], seen & sure & (validity >= settings.reuse_validity))


def join(drawn: Prior, share: Float32, prior: Prior, matte: Float32) -> Prior:
    """Members drawn in some patches, blended into the estimate that was carried; the mixture's mean and deviation.

    Args:
        drawn: of the members; known where any patch was drawn.
        share: [H, W] in [0, 1], the windows' share of the patches that were drawn: the seam is as smooth as theirs.
        prior: the carried estimate.
        matte: [H, W] coverage. Pixels of it that neither knows take the value of the nearest that is known and the
            largest deviation, so that they weigh nothing in the temporal solve.
    """
    own = np.where(drawn.known, share, 0)
    given = np.where(prior.known, 1 - own, 0)
    total = own + given
    weights = [np.divide(part, total, out=np.zeros_like(total), where=total > 0) for part in (own, given)]
    mean = weights[0] * drawn.mean + weights[1] * prior.mean
    square = weights[0] * (drawn.std**2 + (drawn.mean - mean) ** 2)
    square += weights[1] * (prior.std**2 + (prior.mean - mean) ** 2)
    std = np.minimum(np.sqrt(square), LARGEST_STD)
    known = total > 0
    inside = matte > 0
    if not known.all() and (known & inside).any():
        rows, columns = scipy.ndimage.distance_transform_edt(
            ~(known & inside), return_distances=False, return_indices=True
        )
        mean = np.where(known, mean, mean[:, rows, columns])
    mean = np.where(inside, mean, 0).astype(np.float32)
    return Prior(mean, np.where(inside, np.where(known, std, LARGEST_STD), 0).astype(np.float32), known & inside)
