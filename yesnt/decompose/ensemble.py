"""K diffusion members of a frame, their mean and their spread (method.md section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from yesnt.decompose.backend import Backend, GlobalPredictor, MeanPredictor
from yesnt.decompose.blend import Patch, PatchGrid, PatchSum
from yesnt.decompose.confidence import confidence as confidence
from yesnt.decompose.global_context import ContextBatch, Square, context_image
from yesnt.decompose.noise_planes import ensemble_noise
from yesnt.decompose.reuse import Prior, join
from yesnt.decompose.settings import EnsembleSettings

Float32 = NDArray[np.float32]

_MEMORY_FOR_MEMBERS = 256 << 20
"""Bytes for members that are in memory together, at least one; a patch is encoded once for all of them."""


@dataclass(frozen=True)
class Estimate:
    """What the ensemble says of a frame; planes are (roughness, metallic).

    Attributes:
        mean: [2, H, W] in [0, 1], 0 outside the matte.
        std: [2, H, W] population standard deviation over members, in [0, 0.5], 0 outside the matte.
        nfe: [H, W] network evaluations that went into each pixel, blended as the members are.
        total_nfe: network evaluations of the frame (rows of batches without padding, encoding apart).
    """

    mean: Float32
    std: Float32
    nfe: Float32
    total_nfe: int


def decompose_frame(
    rgb: Float32, matte: Float32, backend: Backend, settings: EnsembleSettings, seed: int, frame: int
) -> tuple[Float32, Float32]:
    """Mean and standard deviation of `estimate_frame`."""
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
    """SamplePairs the members of a frame patch by patch, blends each, then takes mean and population std over them.

    A backend that knows what to expect of a patch says so; that is the mean then, and the members tell the std.

    Args:
        rgb: [H, W, 3] linear Rec.709, straight.
        matte: [H, W] coverage; patches without any are skipped.
        backend: the sampler.
        settings: members, overlap, tolerance.
        seed: the job's seed.
        frame: frame number as delivered.
        prior: a keyframe's estimate carried to this frame (`yesnt.decompose.reuse`): patches that it covers are not
            drawn. None: every patch is.

    Returns:
        The estimate; the same bits for any order of patches, worker, restart or number of threads.

    Raises:
        ValueError: shapes disagree, or rgb is not finite inside the matte.
    """
    picture = _Picture.prepare(rgb, matte, backend, settings)
    moments = _Moments(*picture.grid.shape)
    active, total = picture.grid.covering(picture.matte), 0
    if prior is not None:
        active = _uncovered(picture, active, prior, settings)
    at_once = max(1, _MEMORY_FOR_MEMBERS // (4 * (len(backend.noise_sigmas) + 2) * picture.matte.size))
    for members in settings.rounds():
        active = _unsettled(picture.grid, active, picture.matte, moments, settings)
        if not active:
            break
        for start in range(members.start, members.stop, at_once):
            block = range(start, min(start + at_once, members.stop))
            _add_members(moments, picture, active, block, backend, (seed, frame), settings.antithetic)
        total += len(active) * len(members) * backend.nfe
    mean, std = picture.finished(moments.mean), picture.finished(moments.std())
    if prior is not None:
        share = picture.finished(np.minimum(moments.weight / settings.rounds()[0].stop, 1))
        joined = join(Prior(mean, std, share > 0), share, prior, matte)
        mean, std = joined.mean, joined.std
    return Estimate(mean, std, picture.finished(moments.weight * backend.nfe), total)


def _uncovered(
    picture: _Picture, patches: Sequence[Patch], prior: Prior, settings: EnsembleSettings
) -> tuple[Patch, ...]:
    """The patches of whose matte the prior covers too little."""
    rows, columns = prior.known.shape
    inside = picture.matte > 0.5  # flow, and so the prior, knows no more of the matte than this
    known = np.zeros_like(inside)
    known[:rows, :columns] = prior.known
    counts = ((picture.grid.crop(inside, p).sum(), picture.grid.crop(inside & known, p).sum()) for p in patches)
    return tuple(p for p, (all_, there) in zip(patches, counts, strict=True) if there < settings.reuse_share * all_)


@dataclass(frozen=True)
class _Picture:
    """A frame padded to at least one patch: rgb [3, H, W], matte [H, W]; `shape` is the frame's own.

    `whole` is the subject in small, [4, side, side], `square` what it shows, `backend` who is to read it.
    """

    grid: PatchGrid
    rgb: Float32
    matte: Float32
    shape: tuple[int, ...]
    square: Square
    whole: Float32
    backend: Backend

    @classmethod
    def prepare(cls, rgb: Float32, matte: Float32, backend: Backend, settings: EnsembleSettings) -> _Picture:
        """Checks a frame and lays its patches out; arguments as in `estimate_frame`.

        Raises:
            ValueError: shapes disagree, or a value inside the matte is not finite.
        """
        if rgb.shape != (*matte.shape, 3):
            raise ValueError(f"rgb {rgb.shape} must be [H, W, 3] of the matte's [H, W] {matte.shape}")
        inside = matte > 0
        if not np.isfinite(rgb[inside]).all():
            raise ValueError("rgb holds NaN or Inf inside the matte")
        grid = PatchGrid.cover(matte.shape[0], matte.shape[1], backend.patch, settings.overlap, backend.align)
        pad = ((0, grid.height - matte.shape[0]), (0, grid.width - matte.shape[1]))
        clean = np.where(inside[..., None], rgb, 0).astype(np.float32)
        planes, cover = clean.transpose(2, 0, 1), matte.astype(np.float32)
        square = Square.around(cover)
        whole = context_image(planes, cover, square)
        return cls(grid, np.pad(planes, ((0, 0), *pad)), np.pad(cover, pad), matte.shape, square, whole, backend)

    @cached_property
    def auxiliary(self) -> torch.Tensor | None:
        """What the backend says of the whole subject; asked for once, and only if a patch is drawn."""
        if not isinstance(self.backend, GlobalPredictor) or not self.backend.auxiliary_side:
            return None
        picture = context_image(self.rgb, self.matte, self.square, self.backend.auxiliary_side)
        return self.backend.predict_auxiliary(torch.from_numpy(picture)[None])

    def context(self, patches: Sequence[Patch], rows: int) -> ContextBatch:
        """What `rows` rows are told of the whole; rows without a patch are told of its corner."""
        places = np.zeros((rows, 3), np.float32)
        places[: len(patches)] = [self.square.locate(p.top, p.left, self.grid.size) for p in patches]
        told = None if self.auxiliary is None else self.auxiliary.expand(rows, -1, -1, -1)
        return ContextBatch(torch.from_numpy(self.whole).expand(rows, -1, -1, -1), torch.from_numpy(places), told)

    def finished(self, planes: NDArray[np.floating]) -> Float32:
        """Planes [..., H, W] without padding, 0 outside the matte."""
        rows, columns = self.shape
        return np.where(self.matte > 0, planes, 0)[..., :rows, :columns].astype(np.float32, order="C")


class _Moments:
    """Weighted mean and sum of squares per pixel, member by member (West 1979, the weighted form of Welford's).

    What a backend predicts_mean takes the place of the members' mean (Rao and Blackwell: what their mean tends to, without
    the chance of a draw); the spread is of the members alone. Single precision: 4K planes are large, and a deviation
    of members needs no more digits than the members have.
    """

    def __init__(self, height: int, width: int) -> None:
        self.weight = np.zeros((height, width), np.float32)
        self._mean = np.zeros((2, height, width), np.float32)
        self._squares = np.zeros((2, height, width), np.float32)
        self._expected: Float32 | None = None

    def predict_mean(self, value: Float32) -> None:
        """Says what to expect: value [2, H, W]."""
        self._expected = value

    def update(self, value: Float32, weight: Float32) -> None:
        """Adds a member: value [2, H, W], weight [H, W] in [0, 1], the share of windows that hold this member."""
        self.weight += weight
        share = np.divide(weight, self.weight, out=np.zeros_like(self.weight), where=self.weight > 0)
        for plane, mean, squares in zip(value, self._mean, self._squares, strict=True):
            delta = plane - mean
            mean += share * delta
            delta *= plane - mean
            squares += np.multiply(delta, weight, out=delta)

    @property
    def mean(self) -> Float32:
        """[2, H, W]; 0 where there is no member."""
        return self._mean if self._expected is None else self._expected

    def std(self) -> Float32:
        """Population standard deviation [2, H, W] over members; 0 where there is none."""
        found = np.maximum(self._squares, 0)
        found /= np.where(self.weight > 0, self.weight, np.float32(1))
        return np.sqrt(found, out=found)

    def standard_error(self, antithetic: bool) -> Float32:
        """[2, H, W] standard error of the mean, of independent draws; needs two members.

        An antithetic pair has no mean of its own to lose a degree of freedom to; that pairs do better than independent
        draws is not counted. What a backend predicts_mean owes nothing to chance: more members would not change it.
        """
        if self._expected is not None:
            return np.zeros_like(self._mean)
        free = self.weight - np.float32(0 if antithetic else 1)
        return self.std() / np.sqrt(np.maximum(free, np.float32(1e-9)))


def _unsettled(
    grid: PatchGrid, active: Sequence[Patch], matte: Float32, moments: _Moments, settings: EnsembleSettings
) -> tuple[Patch, ...]:
    """The patches whose standard error (root mean square over the matte, the worse plane) exceeds the tolerance."""
    if not moments.weight.any() or settings.tolerance == 0:
        return tuple(active)
    square = moments.standard_error(settings.antithetic) ** 2
    kept = []
    for patch in active:
        inside = grid.crop(matte, patch)
        mean_square = (grid.crop(square, patch) * inside).sum((1, 2)) / inside.sum()
        if mean_square.max() > settings.tolerance**2:
            kept.append(patch)
    return tuple(kept)


def _add_members(
    moments: _Moments,
    picture: _Picture,
    patches: Sequence[Patch],
    block: range,
    backend: Backend,
    key: tuple[int, int],
    antithetic: bool,
) -> None:
    """SamplePairs and blends some members; their noise, the largest of all planes, is gone before more is made."""
    grid = picture.grid
    noises = [ensemble_noise((*key, k), grid.shape, backend.noise_sigmas, antithetic) for k in block]
    sums = [PatchSum(grid, 2) for _ in noises]
    expected = PatchSum(grid, 2) if isinstance(backend, MeanPredictor) and not moments.weight.any() else None
    weights = PatchSum(grid, 1)
    for start in range(0, len(patches), backend.batch):
        chosen = patches[start : start + backend.batch]
        condition = backend.encode(
            _batch(grid, picture.rgb, chosen, backend.batch),
            _batch(grid, picture.matte[None], chosen, backend.batch),
            picture.context(chosen, backend.batch),
        )
        if expected is not None and isinstance(backend, MeanPredictor):
            _add(expected, chosen, backend.predict_mean(condition))
        for noise, member in zip(noises, sums, strict=True):
            _add(member, chosen, backend.sample(condition, _batch(grid, noise, chosen, backend.batch)))
        for patch in chosen:
            weights.add(patch, np.ones((1, grid.size, grid.size), np.float32))
    noises.clear()
    weight = weights.value()[0]
    safe = np.where(weight > 0, weight, np.float32(1))
    if expected is not None:
        moments.predict_mean(_shared(expected, safe))
    for member in sums:
        moments.update(_shared(member, safe), weight)


def _add(total: PatchSum, patches: Sequence[Patch], values: torch.Tensor) -> None:
    """Adds the rows [B, 2, P, P] that belong to patches."""
    for patch, value in zip(patches, values.numpy(force=True), strict=False):
        total.add(patch, np.clip(value, 0, 1))


def _shared(total: PatchSum, weight: Float32) -> Float32:
    value = total.value()
    value /= weight
    return value


def _batch(grid: PatchGrid, image: Float32, patches: Sequence[Patch], rows: int) -> torch.Tensor:
    """Crops [rows, C, P, P]; the last batch is padded with zeros to the one fixed shape."""
    batch = np.zeros((rows, image.shape[0], grid.size, grid.size), dtype=np.float32)
    for row, patch in enumerate(patches):
        batch[row] = grid.crop(image, patch)
    return torch.from_numpy(batch)
