"""Reuse of a keyframe's estimate: propagated along the optical flow to an earlier frame, of which less has to be drawn.

Flow leads from a frame to the next. A frame between keyframes therefore uses the keyframe after it and looks its
pixels up there, with the warp of the temporal energy. Which frames are keyframes depends on their positions only, so
the result of a frame does not depend on the order of computation.
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
    """Estimate of a frame before anything is drawn; planes are (roughness, metallic).

    Attributes:
        mean: [2, H, W] in [0, 1].
        std: [2, H, W] standard deviation of the members behind the mean.
        known: [H, W] where mean and std are valid.
    """

    mean: Float32
    std: Float32
    known: Mask


@dataclass(frozen=True)
class Link:
    """Optical flow from one frame to the next.

    Attributes:
        flow: [H, W, 2] pixels (dx, dy), t -> t+1.
        validity: [H, W] in [0, 1].
    """

    flow: Float32
    validity: Float32


def propagate_keyframe(
    mean: Float32, std: Float32, links: Sequence[Link], mattes: Sequence[Mask], settings: EnsembleSettings
) -> Prior:
    """Warps the estimate of a keyframe to an earlier frame.

    Args:
        mean: [2, H, W] of the keyframe; further planes are warped alike.
        std: [2, H, W] of the keyframe; as many planes.
        links: flow from the earlier frame to the keyframe, in order of time; at least one.
        mattes: [H, W] bool, of every frame from the earlier one to the keyframe: one more than links.
        settings: thresholds of validity and confidence.

    Returns:
        The estimate at the earlier frame; `known` where the chained flow is valid and the keyframe's confidence
        suffices.
    """
    flow, validity = chained(links, mattes)
    planes, inside = sample_next(np.concatenate([mean, std]).transpose(1, 2, 0), flow, mattes[0], mattes[-1])
    propagated, count = planes.transpose(2, 0, 1), len(mean)
    confident = confidence(propagated[count:], LARGEST_STD).min(axis=0) >= settings.reuse_confidence
    return Prior(propagated[:count], propagated[count:], inside & confident & (validity >= settings.reuse_validity))


def chained(links: Sequence[Link], mattes: Sequence[Mask]) -> tuple[Float32, Float32]:
    """Flow [H, W, 2] from a frame to a later one, and the product [H, W] of the validities on the way.

    Args:
        links: flow from each frame to the next, in order of time; at least one.
        mattes: [H, W] bool, of every frame on the way: one more than links.
    """
    flow, validity = links[-1].flow, links[-1].validity
    for link, now, then in zip(links[-2::-1], mattes[-3::-1], mattes[-2::-1], strict=False):
        onward, inside = sample_next(np.concatenate([flow, validity[..., None]], axis=-1), link.flow, now, then)
        flow, validity = link.flow + onward[..., :2], link.validity * onward[..., 2] * inside
    return flow, validity


def combine(drawn: Prior, weight: Float32, prior: Prior, matte: Float32) -> Prior:
    """Blends drawn members into a propagated estimate; mean and deviation are those of the mixture.

    Args:
        drawn: estimate from the members; known where any patch was drawn.
        weight: [H, W] in [0, 1], sum of the blending windows of the drawn patches, so that seams are as smooth as
            theirs.
        prior: the propagated estimate.
        matte: [H, W] coverage in [0, 1].

    Returns:
        The mixture, 0 outside the matte. Pixels of the matte that neither estimate covers take the mean of the nearest
        covered pixel and the largest deviation, hence the least confidence.
    """
    own = np.where(drawn.known, weight, 0)
    other = np.where(prior.known, 1 - own, 0)
    total = own + other
    weights = [np.divide(part, total, out=np.zeros_like(total), where=total > 0) for part in (own, other)]
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
