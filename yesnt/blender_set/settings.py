"""What a quality means in Blender."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

DEPTH_FACTOR = 4
"""Squares along a pixel's side through which the set's depth is sampled."""


@dataclass(frozen=True)
class BlenderSettings:
    """Samples of Cycles and the size of the baked map.

    Attributes:
        samples: of a pixel of the plates, before denoising.
        map_rows: rows of the baked map, which has twice as many columns.
        map_samples: of a texel of the map.
    """

    samples: int
    map_rows: int
    map_samples: int


QUALITIES: Mapping[str, BlenderSettings] = MappingProxyType({
    "draft": BlenderSettings(16, 128, 64),
    "standard": BlenderSettings(64, 256, 128),
    "final": BlenderSettings(256, 512, 256),
    "reference": BlenderSettings(1024, 512, 1024),
})  # fmt: skip
"""By the job's `quality`."""
