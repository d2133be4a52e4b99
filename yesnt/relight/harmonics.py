"""Real spherical harmonics of bands 0-2, and their convolution with a clamped cosine (Ramamoorthi & Hanrahan 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating]

BANDS = (np.pi, 2 * np.pi / 3, np.pi / 4)
"""Coefficient of irradiance over that of radiance, per band."""

TERMS = 9
"""Number of harmonics of bands 0-2."""


def basis(direction: Float) -> NDArray[np.float64]:
    """Values [..., 9] of the orthonormal harmonics in unit directions [..., 3]; bands 0-2, m ascending."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    first, second = np.sqrt(3 / (4 * np.pi)), 0.5 * np.sqrt(15 / np.pi)
    values = [
        np.full_like(x, 0.5 / np.sqrt(np.pi)),
        *(first * a for a in (y, z, x)),
        *(second * a for a in (x * y, y * z)),
        0.25 * np.sqrt(5 / np.pi) * (3 * z * z - 1),
        second * x * z,
        0.5 * second * (x * x - y * y),
    ]
    return np.stack(values, axis=-1)
