"""The sun of a map: the bright, small region that gives the most light (docs/relight.md, "Sun and rest").

It is what a compositor wants to scale against the rest: the sun outdoors, the strongest lamp indoors. Only what it
gives beyond the radiance around it is taken, so that a sky without its sun has no hole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.envmap import EnvMap, row_solid_angles

F32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

BRIGHT = 16.0
"""Luminance over the map's mean from which a texel belongs to a lamp: a window as wide as a steradian does not."""

LEAST = 0.02
"""Share of the map's luminance that a lamp gives at least: a reflection in a window is no sun."""

_AROUND = 2  # texels beyond the region from which the radiance that surrounds it is taken


@dataclass(frozen=True)
class Sun:
    """The sun of a map.

    Attributes:
        env: the map with the sun alone: black elsewhere, and black everywhere where there is none.
        share: of the map's luminance that it gives, 0..1; 0 where there is none.
        others: number of other lamps, which are not in it.
    """

    env: EnvMap
    share: float
    others: int


def find_sun(env: EnvMap) -> Sun:
    """The sun of a map; pure, and the same for every rotation and exposure.

    Regions are joined over the seam of the map. Of several the one with the most luminance is the sun.
    """
    radiance = env.radiance.astype(np.float64)
    height, width = radiance.shape[:2]
    power = luminance(radiance) * row_solid_angles(height, width)[:, None]
    whole = float(power.sum())
    regions = _regions(luminance(radiance) > BRIGHT * whole / (4 * np.pi))
    lights = np.array([power[region].sum() for region in regions])
    lamps = np.flatnonzero(lights >= LEAST * whole) if whole > 0 else np.zeros(0, np.intp)
    if not len(lamps):
        return Sun(replace(env, radiance=np.zeros_like(env.radiance)), 0.0, 0)
    chosen = regions[lamps[lights[lamps].argmax()]]
    excess = np.where(chosen[..., None], np.maximum(radiance - _around(radiance, chosen), 0), 0)
    given = float((luminance(excess) * row_solid_angles(height, width)[:, None]).sum())
    return Sun(replace(env, radiance=excess.astype(np.float32)), given / whole, len(lamps) - 1)


def _regions(bright: Bools) -> list[Bools]:
    """Connected regions [H, W] of a lat-long mask, neighbours at corners included; columns wrap around."""
    from scipy.ndimage import label

    joined = np.concatenate([bright, bright[:, :1]], axis=1)  # the first column again, behind the last
    numbers, count = label(joined, np.ones((3, 3)))
    names = np.arange(count + 1)
    for first, last in zip(numbers[bright[:, 0], 0], numbers[bright[:, 0], -1], strict=True):
        names[names == names[last]] = names[first]
    regions = names[numbers[:, :-1]]
    return [regions == number for number in np.unique(regions[bright])]


def _around(radiance: NDArray[np.float64], region: Bools) -> NDArray[np.float64]:
    """Mean radiance [3] of the texels around a region, columns wrapping; 0 where it is the whole map."""
    from scipy.ndimage import binary_dilation

    wide = np.pad(region, ((0, 0), (_AROUND, _AROUND)), mode="wrap")
    ring = binary_dilation(wide, np.ones((3, 3)), iterations=_AROUND)[:, _AROUND:-_AROUND] & ~region
    return radiance[ring].mean(axis=0) if ring.any() else np.zeros(3)
