"""Windows of frames for video backends: layout, mean and spread of their members, and blending over time.

A window is one task. It yields a mean and a spread per frame. Where windows overlap, they are mixed with raised-cosine
weights over time. Disagreement of two windows increases the spread, which lowers the weight of a seam in the temporal
solve, so that it is bridged along the flow.
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
    """Frames that are processed together.

    Attributes:
        index: number of the window.
        lane: windows of one lane do not overlap, so that each lane can be stored as one sequence.
        span: positions in the shot; shorter than the model's window only if the shot is.
        weights: weight of each frame; over all windows they sum to 1 at every position.
    """

    index: int
    lane: int
    span: Span
    weights: tuple[float, ...]


def plan_windows(length: int, footprint: Footprint) -> tuple[Window, ...]:
    """Returns evenly spread windows that cover `length` frames; a shot shorter than one window gives one.

    Args:
        length: frames of the shot.
        footprint: window size and overlap of the backend.
    """
    size, overlap = min(footprint.window, length), min(footprint.overlap, footprint.window - 1)
    origins = patch_origins(length, size, min(overlap, size - 1))
    lanes = 1 + max((sum(o < later < o + size for later in origins) for o in origins), default=0)
    weights = unit_windows(origins, size, length)
    return tuple(
        Window(i, i % lanes, Span(origin, origin + size), tuple(float(w) for w in weights[i]))
        for i, origin in enumerate(origins)
    )


def make_clip(rgb: Sequence[Float32], matte: Sequence[Float32], frames: Sequence[int], length: int) -> Clip:
    """Builds a clip of the length that the model takes, repeating the last frame with consecutive frame numbers.

    Args:
        rgb: [H, W, 3] each, straight linear Rec.709.
        matte: [H, W] each, coverage in [0, 1].
        frames: frame numbers.
        length: frames of the clip, at least as many as given.

    Raises:
        ValueError: a colour inside the matte is not finite.
    """
    last, missing = len(frames) - 1, length - len(frames)
    chosen = [*range(len(frames)), *[last] * missing]
    numbers = (*frames, *(frames[last] + i for i in range(1, missing + 1)))
    mattes = np.stack([matte[i] for i in chosen]).astype(np.float32)
    colors = np.stack([np.where(matte[i][..., None] > 0, rgb[i], 0) for i in chosen]).astype(np.float32)
    if not np.isfinite(colors).all():
        raise ValueError("rgb holds NaN or Inf inside the matte")
    return Clip(colors, mattes, numbers)


@dataclass(frozen=True)
class ClipEstimate:
    """Materials of a clip.

    Attributes:
        mean: [F, 2, H, W] in [0, 1], 0 outside the matte.
        std: [F, 2, H, W] population standard deviation over members, 0 outside the matte.
        members: number of members that were drawn.
    """

    mean: Float32
    std: Float32
    members: int


def estimate_clip(clip: Clip, backend: VideoBackend, settings: EnsembleSettings, seed: int) -> ClipEstimate:
    """Draws members of a clip until the standard error of their mean is within the tolerance.

    Args:
        clip: frames of the window.
        backend: the sampler.
        settings: members and tolerance.
        seed: seed of the job.
    """
    inside = (clip.matte > 0)[:, None]
    mean = np.zeros((len(clip.frames), 2, *clip.matte.shape[1:]), np.float32)
    squares, count = np.zeros_like(mean), 0
    if inside.any():
        for members in settings.rounds():
            if count and settings.tolerance and _converged(squares, inside, count, settings):
                break
            for value in backend.draw(clip, seed, members, settings):
                count += 1
                delta = np.clip(value, 0, 1) - mean
                mean += delta / count
                squares += delta * (np.clip(value, 0, 1) - mean)
    std = np.sqrt(np.maximum(squares, 0) / max(count, 1))
    return ClipEstimate(np.where(inside, mean, 0), np.where(inside, std, 0), count)


def _converged(squares: Float32, inside: NDArray[np.bool_], count: int, settings: EnsembleSettings) -> bool:
    """Whether the standard error is within the tolerance: its root mean square over the matte, in the worse plane."""
    freedom = count - (0 if settings.antithetic else 1)
    error = (squares * inside).sum((0, 2, 3)) / (inside.sum() * count * max(freedom, 1))
    return bool(error.max() <= settings.tolerance**2)


def blend(means: Sequence[Float32], stds: Sequence[Float32], weights: Sequence[float]) -> tuple[Float32, Float32]:
    """Mixes the estimates of a frame from several windows.

    Args:
        means: [2, H, W] of each window.
        stds: [2, H, W] of each window.
        weights: weight of each window, summing to 1.

    Returns:
        Mean and standard deviation [2, H, W] of the mixture.
    """
    mean = np.zeros_like(means[0])
    for one, weight in zip(means, weights, strict=True):
        mean += np.float32(weight) * one
    square = np.zeros_like(mean)
    for one, std, weight in zip(means, stds, weights, strict=True):
        square += np.float32(weight) * (std**2 + (one - mean) ** 2)
    return mean, np.minimum(np.sqrt(square), np.float32(LARGEST_STD))
