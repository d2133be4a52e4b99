"""Compositing in scene-linear light with associated alpha (method.md section 6; Porter and Duff 1984, "over")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def associate(color: Float32, opacity: Float32) -> Float32:
    """Straight colour [H, W, 3] and opacity [H, W] as associated RGBA [H, W, 4]."""
    return np.concatenate([color * opacity[..., None], opacity[..., None]], axis=-1).astype(np.float32)


def over(foreground: Float32, background: Float32) -> Float32:
    """Foreground over background: out = fg + (1 - a) bg.

    Args:
        foreground: [H, W, 4] associated.
        background: [H, W, 3] or [H, W, 4] associated; three components count as opaque.

    Returns:
        [H, W, 4] associated.
    """
    if background.shape[-1] == 3:
        background = np.concatenate([background, np.ones_like(background[..., :1])], axis=-1)
    return (foreground + (1 - foreground[..., 3:]) * background).astype(np.float32)
