"""Ensemble of diffusion members of a frame: their mean and spread (docs/method.md section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from yesnt.decompose.backend import Backend, MeanPredictor
from yesnt.decompose.blend import Patch, PatchSum
from yesnt.decompose.moments import Moments
from yesnt.decompose.noise_planes import ensemble_noise
from yesnt.decompose.padded_frame import PaddedFrame, crop_batch
from yesnt.decompose.reuse import Prior, combine
from yesnt.decompose.settings import EnsembleSettings

Float32 = NDArray[np.float32]

_MEMORY_FOR_MEMBERS = 256 << 20
"""Bytes for the planes of members that are drawn together (at least one). A patch is encoded once for all of them."""


@dataclass(frozen=True)
class Estimate:
    """Materials of a frame; planes are (roughness, metallic).

    Attributes:
        mean: [2, H, W] in [0, 1], 0 outside the matte.
        std: [2, H, W] population standard deviation over members, in [0, 0.5], 0 outside the matte.
        nfe: [H, W] number of function evaluations (network calls) per pixel, blended like the members.
        total_nfe: network evaluations of the frame: rows of batches without padding, without encoding.
    """

    mean: Float32
    std: Float32
    nfe: Float32
    total_nfe: int


def decompose_frame(
    rgb: Float32, matte: Float32, backend: Backend, settings: EnsembleSettings, seed: int, frame: int
) -> tuple[Float32, Float32]:
    """Returns mean and standard deviation [2, H, W] of `estimate_frame`."""
    estimate = estimate_frame(rgb, matte, backend, settings, seed, frame)
    return estimate.mean, estimate.std


def estimate_frame(
    rgb: Float32,
    matte: Float32,
    backend: Backend,
    settings: EnsembleSettings,
    seed: int,
    frame: int,
    prior: Prior | None = None,
) -> Estimate:
    """Draws the members of a frame patch by patch, blends each, and takes mean and population std over the members.

    The mean that a backend predicts (`MeanPredictor`) replaces the sample mean; the members then only give the std.

    Args:
        rgb: [H, W, 3] linear Rec.709, straight.
        matte: [H, W] coverage in [0, 1]; patches without any are skipped.
        backend: the sampler.
        settings: members, overlap and tolerance.
        seed: seed of the job.
        frame: frame number as delivered.
        prior: estimate of a keyframe propagated to this frame (`yesnt.decompose.reuse`); patches that it covers are
            not drawn. None: all patches are drawn.

    Returns:
        The estimate. It has the same bits for any order of patches, worker, restart or number of threads.

    Raises:
        ValueError: shapes disagree, or rgb is not finite inside the matte.
    """
    padded = PaddedFrame.prepare(rgb, matte, backend, settings.overlap)
    moments = Moments(*padded.grid.shape)
    active, total = padded.grid.covering(padded.matte), 0
    if prior is not None:
        active = _uncovered(padded, active, prior, settings)
    at_once = max(1, _MEMORY_FOR_MEMBERS // (4 * (len(backend.noise_sigmas) + 2) * padded.matte.size))
    for members in settings.rounds():
        active = _unconverged(padded, active, moments, settings)
        if not active:
            break
        for start in range(members.start, members.stop, at_once):
            block = range(start, min(start + at_once, members.stop))
            _add_members(moments, padded, active, block, (seed, frame), settings.antithetic)
        total += len(active) * len(members) * backend.nfe
    mean, std = padded.unpad(moments.mean), padded.unpad(moments.std())
    if prior is not None:
        weight = padded.unpad(np.minimum(moments.weight / settings.rounds()[0].stop, 1))
        combined = combine(Prior(mean, std, weight > 0), weight, prior, matte)
        mean, std = combined.mean, combined.std
    return Estimate(mean, std, padded.unpad(moments.weight * backend.nfe), total)


def _uncovered(
    padded: PaddedFrame, patches: Sequence[Patch], prior: Prior, settings: EnsembleSettings
) -> tuple[Patch, ...]:
    """Patches of whose matte the prior covers less than `reuse_share`."""
    rows, columns = prior.known.shape
    inside = padded.matte > 0.5  # the flow, and so the prior, is defined on this binary matte only
    known = np.zeros_like(inside)
    known[:rows, :columns] = prior.known
    counts = ((padded.grid.crop(inside, p).sum(), padded.grid.crop(inside & known, p).sum()) for p in patches)
    return tuple(
        p for p, (total, covered) in zip(patches, counts, strict=True) if covered < settings.reuse_share * total
    )


def _unconverged(
    padded: PaddedFrame, active: Sequence[Patch], moments: Moments, settings: EnsembleSettings
) -> tuple[Patch, ...]:
    """Patches whose standard error exceeds the tolerance: its root mean square over the matte, in the worse plane."""
    if not moments.weight.any() or settings.tolerance == 0:
        return tuple(active)
    square = moments.standard_error(settings.antithetic) ** 2
    found = []
    for patch in active:
        inside = padded.grid.crop(padded.matte, patch)
        mean_square = (padded.grid.crop(square, patch) * inside).sum((1, 2)) / inside.sum()
        if mean_square.max() > settings.tolerance**2:
            found.append(patch)
    return tuple(found)


def _add_members(
    moments: Moments,
    padded: PaddedFrame,
    patches: Sequence[Patch],
    block: range,
    key: tuple[int, int],
    antithetic: bool,
) -> None:
    """Draws the members of a block, blends them and adds them to the moments.

    Args:
        moments: of the members before; in the first block they also receive the predicted mean.
        padded: frame with its backend.
        patches: patches to draw.
        block: member numbers k.
        key: seed of the job and frame number.
        antithetic: whether odd members use the negated noise of the even member before.
    """
    grid, backend = padded.grid, padded.backend
    noises = [ensemble_noise((*key, k), grid.shape, backend.noise_sigmas, antithetic) for k in block]
    sums = [PatchSum(grid, 2) for _ in noises]
    predicted = PatchSum(grid, 2) if isinstance(backend, MeanPredictor) and not moments.weight.any() else None
    for start in range(0, len(patches), backend.batch):
        chosen = patches[start : start + backend.batch]
        condition = padded.encode(chosen)
        if predicted is not None and isinstance(backend, MeanPredictor):
            _add(predicted, chosen, backend.predict_mean(condition))
        for noise, member in zip(noises, sums, strict=True):
            _add(member, chosen, backend.sample(condition, crop_batch(grid, noise, chosen, backend.batch)))
    noises.clear()  # the largest planes of all, no longer needed when the sums are converted to float
    weight = _window_sum(padded, patches)
    divisor = np.where(weight > 0, weight, np.float32(1))
    if predicted is not None:
        moments.set_mean(_normalised(predicted, divisor))
    for member in sums:
        moments.update(_normalised(member, divisor), weight)


def _window_sum(padded: PaddedFrame, patches: Sequence[Patch]) -> Float32:
    """Sum [H, W] of the windows of some patches, with the rounding of `PatchSum`."""
    size, total = padded.grid.size, PatchSum(padded.grid, 1)
    for patch in patches:
        total.add(patch, np.ones((1, size, size), np.float32))
    return total.value()[0]


def _add(total: PatchSum, patches: Sequence[Patch], values: torch.Tensor) -> None:
    """Adds the rows of `values` [B, 2, P, P] that belong to patches; padding rows are left out."""
    for patch, value in zip(patches, values.numpy(force=True), strict=False):
        total.add(patch, np.clip(value, 0, 1))


def _normalised(total: PatchSum, divisor: Float32) -> Float32:
    value = total.value()
    value /= divisor
    return value
