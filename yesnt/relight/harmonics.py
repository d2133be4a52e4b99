"""Irradiance of a whole map in spherical harmonics up to band 4 (Ramamoorthi & Hanrahan 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating]

BANDS = (np.pi, 2 * np.pi / 3, np.pi / 4, 0.0, -np.pi / 24)
"""Transfer of the clamped cosine per band; the next that is not 0 is pi/64."""

_BAND_OF = np.repeat(np.arange(5), 2 * np.arange(5) + 1)


def basis(direction: Float) -> NDArray[np.float64]:
    """Real orthonormal harmonics [..., 25] of unit directions [..., 3], bands 0-4, m ascending."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    root = np.sqrt
    values = [
        np.full_like(x, 0.5 * root(1 / np.pi)),
        *(root(3 / (4 * np.pi)) * a for a in (y, z, x)),
        *(0.5 * root(15 / np.pi) * a for a in (x * y, y * z)),
        0.25 * root(5 / np.pi) * (3 * zz - 1),
        0.5 * root(15 / np.pi) * x * z,
        0.25 * root(15 / np.pi) * (xx - yy),
        0.25 * root(35 / (2 * np.pi)) * y * (3 * xx - yy),
        0.5 * root(105 / np.pi) * x * y * z,
        0.25 * root(21 / (2 * np.pi)) * y * (5 * zz - 1),
        0.25 * root(7 / np.pi) * z * (5 * zz - 3),
        0.25 * root(21 / (2 * np.pi)) * x * (5 * zz - 1),
        0.25 * root(105 / np.pi) * z * (xx - yy),
        0.25 * root(35 / (2 * np.pi)) * x * (xx - 3 * yy),
        0.75 * root(35 / np.pi) * x * y * (xx - yy),
        0.75 * root(35 / (2 * np.pi)) * y * z * (3 * xx - yy),
        0.75 * root(5 / np.pi) * x * y * (7 * zz - 1),
        0.75 * root(5 / (2 * np.pi)) * y * z * (7 * zz - 3),
        3 / 16 * root(1 / np.pi) * (35 * zz * zz - 30 * zz + 3),
        0.75 * root(5 / (2 * np.pi)) * x * z * (7 * zz - 3),
        3 / 8 * root(5 / np.pi) * (xx - yy) * (7 * zz - 1),
        0.75 * root(35 / (2 * np.pi)) * x * z * (xx - 3 * yy),
        3 / 16 * root(35 / np.pi) * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
    ]
    return np.stack(values, axis=-1)


def project_irradiance(direction: Float, energy: Float) -> NDArray[np.float64]:
    """Coefficients [25, 3] from texels: directions [3, T], radiance times solid angle [3, T]."""
    return np.asarray(BANDS)[_BAND_OF][:, None] * (basis(direction.T).T @ energy.T.astype(np.float64))


def irradiance(coefficients: Float, normal: Float) -> NDArray[np.float32]:
    """Irradiance [..., 3] on unit normals [..., 3]; negative lobes of the truncation are cut."""
    return np.maximum(basis(normal) @ coefficients, 0).astype(np.float32)
