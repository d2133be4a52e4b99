"""Layers of a scene that was rendered with and without the subject (docs/method.md section 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from yesnt.scene.holdout import holdout_coverage, split_front

F32 = NDArray[np.float32]

_NOISE_WINDOW = 5  # pixels: the glossy passes are not denoised
_DARKEST = 1e-4  # radiance: below it there is nothing to throw a shadow on


@dataclass(frozen=True)
class SceneLayers:
    """What the composite takes from the scene.

    Attributes:
        open: [H, W, 3] what stands behind the subject, without the subject.
        ratio: [H, W, 3] what the set scatters with the subject over without it, 0..1.
        added: [H, W, 3] what the subject adds to or takes from the set's light beside its shadow; signed.
        holdout: [H, W] coverage of parts of the set before the subject.
        front: [H, W, 3] light of these parts, associated with `holdout`.
    """

    open: F32
    ratio: F32
    added: F32
    holdout: F32
    front: F32


def scene_layers(
    without: tuple[F32, F32], present: tuple[F32, F32], depth: F32, subject: tuple[F32, F32]
) -> SceneLayers:
    """Layers of which `front + (1 - holdout) (open ratio + added)` is the plate with the subject's effect.

    Args:
        without: radiance of the scene [H, W, 3], and the part that glossy surfaces reflect.
        present: the same with the subject, which the camera does not see.
        depth: [n H, n W] planar metres of the scene.
        subject: z [H, W] in planar metres, 0 on a miss, and opacity [H, W].
    """
    z, opacity = subject
    known = holdout_coverage(depth, z, opacity)
    front, back = split_front(present[0], known)
    _, clean = split_front(without[0], known)
    covered = (opacity > 0)[..., None]  # elsewhere nothing stands behind these parts, and the plate is whole
    front = np.where(covered, front, np.float32(0))
    back, clean = np.where(covered, back, present[0]), np.where(covered, clean, without[0])
    ratio = shadow_ratio(without, present)
    return SceneLayers(clean, ratio, back - clean * ratio, np.where(covered[..., 0], known, np.float32(0)), front)


def shadow_ratio(without: tuple[F32, F32], present: tuple[F32, F32]) -> F32:
    """What the set scatters with the subject over without it, [H, W, 3], at most 1.

    What glossy surfaces reflect is left out: a subject in a mirror is no shadow. The ratio is 1 where nothing changes.
    """
    clean, dimmed = (_scattered(*plate) for plate in (without, present))
    ratio = np.where(clean > _DARKEST, dimmed / np.maximum(clean, _DARKEST), 1)
    same = (without[0] == present[0]).all(axis=-1, keepdims=True)
    return np.where(same, 1, np.clip(ratio, 0, 1)).astype(np.float32)


def _scattered(radiance: F32, glossy: F32) -> F32:
    """Radiance [H, W, 3] without glossy reflection: the share of the noisy glossy pass is averaged over a window."""
    window = (_NOISE_WINDOW, _NOISE_WINDOW, 1)
    total, shiny = (uniform_filter(plane, window, mode="nearest") for plane in (radiance, glossy))
    share = np.clip(shiny / np.maximum(total, _DARKEST), 0, 1)
    out: F32 = radiance * (1 - share)
    return out
