"""The plate's exposure against the capture light: which albedo would a matt surface need to look as bright?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.envmap import EnvMap, cell_moments
from yesnt.relight.harmonics import BANDS, basis
from yesnt.runtime.checks.consistency.sample import Sample

F64 = NDArray[np.float64]

_GRID = (16, 32)  # rows and columns: bands 0-2 need no more
_FLOOR = 0.05  # least irradiance, of the mean: truncated harmonics ring below 0
_BAND = np.repeat(BANDS, (1, 3, 5))


def implied_albedo(sample: Sample, light: EnvMap) -> F64:
    """Albedo [N] of a matt, unoccluded surface that would look as each pixel does; of pixels with a normal."""
    normal = sample.world_normal
    length = np.linalg.norm(normal, axis=1)
    known = length > 0.1
    irradiance = basis(normal[known] / length[known, None]) @ _irradiance(light)
    irradiance = np.maximum(irradiance, max(_FLOOR * float(irradiance.mean()), 1e-12)) if known.any() else irradiance
    return np.pi * luminance(sample.color[known]) / irradiance


def _irradiance(light: EnvMap) -> F64:
    """Harmonics [9] of the irradiance in world axes, luminance (Ramamoorthi & Hanrahan 2001)."""
    cells = cell_moments(light, _GRID).reshape(-1, 10)
    direction = cells[:, 7:] / np.linalg.norm(cells[:, 7:], axis=1, keepdims=True) @ light.world_from_map.T
    return luminance(cells[:, :3]) @ basis(direction) * _BAND
