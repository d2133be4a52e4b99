"""Windows of frames for video backends: where they lie, their members' mean and spread, and how they are blended.

A window is a task. Its estimate is a mean and a spread a frame; where windows overlap, the two are mixed with
raised-cosine weights in time. Disagreement of two windows becomes spread, so the temporal solve trusts a seam less and
bridges it along the flow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.blocks import Span, patch_origins
from yesnt.decompose.backend import Clip, Footprint, VideoBackend
from yesnt.decompose.blend import unit_windows
from yesnt.decompose.confidence import LARGEST_STD
from yesnt.decompose.settings import EnsembleSettings

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Window:
    """Frames that are drawn together.

    Attributes:
        index: number of the window.
        lane: windows of one lane do not overlap, so that each lane can be stored as one sequence.
        span: positions in the shot; shorter than the model's window only if the shot is.
        weights: of each of its frames; over all windows they sum to 1 at every position.
    """

    index: int
    lane: int
    span: Span
    weights: tuple[float, ...]


def plan_windows(length: int, footprint: Footprint) -> tuple[Window, ...]:
    """Windows that cover `length` frames, spread evenly; a shot shorter than one window gives one."""
    size, overlap = min(footprint.window, length), min(footprint.overlap, footprint.window - 1)
    origins = patch_origins(length, size, min(overlap, size - 1))
    lanes = 1 + max((sum(o < later < o + size for later in origins) for o in origins), default=0)
    weights = unit_windows(origins, size, length)
    return tuple(
        Window(i, i % lanes, Span(origin, origin + size), tuple(float(w) for w in weights[i]))
        for i, origin in enumerate(origins)
    )


def make_clip(rgb: Sequence[Float32], matte: Sequence[Float32], frames: Sequence[int], length: int) -> Clip:
    """A clip as long as the model wants it: the last frame is repeated, its number counts on.

    Args:
        rgb: [H, W, 3] each, straight linear Rec.709.
        matte: [H, W] each.
        frames: their numbers.
        length: of the clip, at least that many.

    Raises:
        ValueError: a colour inside the matte is not finite.
    """
    last, lacking = len(frames) - 1, length - len(frames)
    chosen = [*range(len(frames)), *[last] * lacking]
    numbers = (*frames, *(frames[last] + i for i in range(1, lacking + 1)))
    mattes = np.stack([matte[i] for i in chosen]).astype(np.float32)
    colors = np.stack([np.where(matte[i][..., None] > 0, rgb[i], 0) for i in chosen]).astype(np.float32)
    if not np.isfinite(colors).all():
        raise ValueError("rgb holds NaN or Inf inside the matte")
    return Clip(colors, mattes, numbers)


@dataclass(frozen=True)
class ClipEstimate:
    """Mean and population standard deviation [F, 2, H, W] of a clip, 0 outside the matte; members that were drawn."""

    mean: Float32
    std: Float32
    members: int


def estimate_clip(clip: Clip, backend: VideoBackend, settings: EnsembleSettings, seed: int) -> ClipEstimate:
    """SamplePairs members of a clip until the standard error of their mean is small enough everywhere in the mean.

    Args:
        clip: the window's frames.
        backend: the sampler.
        settings: members and tolerance.
        seed: the job's seed.
    """
    inside = (clip.matte > 0)[:, None]
    mean = np.zeros((len(clip.frames), 2, *clip.matte.shape[1:]), np.float32)
    squares, count = np.zeros_like(mean), 0
    if inside.any():
        for members in settings.rounds():
            if count and settings.tolerance and _settled(squares, inside, count, settings):
                break
            for value in backend.draw(clip, seed, members, settings):
                count += 1
                delta = np.clip(value, 0, 1) - mean
                mean += delta / count
                squares += delta * (np.clip(value, 0, 1) - mean)
    std = np.sqrt(np.maximum(squares, 0) / max(count, 1))
    return ClipEstimate(np.where(inside, mean, 0), np.where(inside, std, 0), count)


def _settled(squares: Float32, inside: NDArray[np.bool_], count: int, settings: EnsembleSettings) -> bool:
    """Whether the standard error (root mean square over the matte, the worse plane) is within the tolerance."""
    freedom = count - (0 if settings.antithetic else 1)
    error = (squares * inside).sum((0, 2, 3)) / (inside.sum() * count * max(freedom, 1))
    return bool(error.max() <= settings.tolerance**2)


def blend(means: Sequence[Float32], stds: Sequence[Float32], weights: Sequence[float]) -> tuple[Float32, Float32]:
    """Mean and deviation [2, H, W] of a frame that several windows know: those of their mixture.

    Args:
        means: [2, H, W] of each window.
        stds: [2, H, W] of each window.
        weights: of each window, summing to 1.
    """
    mean = np.zeros_like(means[0])
    for one, weight in zip(means, weights, strict=True):
        mean += np.float32(weight) * one
    square = np.zeros_like(mean)
    for one, std, weight in zip(means, stds, weights, strict=True):
        square += np.float32(weight) * (std**2 + (one - mean) ** 2)
    return mean, np.minimum(np.sqrt(square), np.float32(LARGEST_STD))
