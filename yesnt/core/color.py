"""Colour arithmetic on scene-linear Rec.709: transfer functions, luminance, alpha association. NumPy in and out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]

LUMINANCE_REC709 = (0.2126, 0.7152, 0.0722)
"""Weights of linear R, G, B in luminance (ITU-R BT.709)."""


def srgb_encode(linear: FloatArray) -> FloatArray:
    """Linear [0, 1] to sRGB code values (IEC 61966-2-1); input is clipped to [0, 1]."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055)


def srgb_decode(encoded: FloatArray) -> FloatArray:
    """Decodes sRGB code values in [0, 1] to linear (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, np.power((np.maximum(encoded, 0.04045) + 0.055) / 1.055, 2.4))


def display_encode(linear: FloatArray) -> FloatArray:
    """Linear light to sRGB code values, not clipped: the curve goes on above 1, and is mirrored below 0."""
    x = np.abs(linear)
    code = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055)
    return np.copysign(code, linear)


def display_decode(encoded: FloatArray) -> FloatArray:
    """Inverse of `display_encode`."""
    x = np.abs(encoded)
    return np.copysign(srgb_decode(x), encoded)


def luminance(rgb: FloatArray) -> FloatArray:
    """Relative luminance of linear Rec.709 `[..., 3]`; returns `[...]`."""
    return rgb @ np.asarray(LUMINANCE_REC709, dtype=rgb.dtype)


def straighten(rgb: FloatArray, opacity: FloatArray) -> FloatArray:
    """Divides associated colour `[..., 3]` by its opacity `[...]`; 0 where the opacity is 0.

    The division is not clamped below: a thin hair of opacity 0.01 keeps its own colour.
    """
    safe_opacity = np.where(opacity > 0, opacity, 1.0)
    return np.where(opacity[..., None] > 0, rgb / safe_opacity[..., None], 0.0).astype(rgb.dtype, copy=False)
