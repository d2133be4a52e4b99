"""Light of edge pixels: extended outward from the pixels around, and multiplied with the plate's own colour.

At the middle of a pixel that the subject covers in part, the G-buffer shows what lies there by chance: a normal of the
far side, a grazing angle. Light that is computed there makes dark and bright rims. The plate's colour, divided by its
coverage, is right there. So the diffuse light of such a pixel is the plate's colour p times what the change of light
does to the plate around it, and its specular light is no more than the pixels around it would allow:

    diffuse' = p sum(w diffuse) / sum(w captured),    specular' = specular min(1, mean(w c) / c),

with `captured` and c the radiance and its specular part under the light of the plate, and weights w = a^2 of the
coverage a under a filter of 3 x 3 pixels: solid pixels count most, and in a hair its own pixels do. Per channel, and
linear in the light. Grain and paint of the plate stay. What this is worth is measured in docs/relight.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.pixel_filter import spread

F32 = NDArray[np.float32]

EDGE = 0.98
"""Coverage below which a pixel is one of the edge."""

SIDE = 0.245
"""Weight of each neighbour along an axis: a Gaussian of 0.7 pixels, the best of 0.5 to 1.5."""

_DARK = 1e-5  # radiance below which nothing tells what a change of light does


class CapturedLight(NamedTuple):
    """Radiance [H, W, 3] that the materials of a frame send to the camera under the light of the plate.

    Attributes:
        plate: what the plate shows, straight.
        diffuse: of its base colour, as computed.
        specular: the same.
    """

    plate: F32
    diffuse: F32
    specular: F32


def extend_light(diffuse: F32, specular: F32, captured: CapturedLight, coverage: F32) -> tuple[F32, F32]:
    """Diffuse and specular light with those of edge pixels replaced; copies, linear in each.

    Args:
        diffuse: [H, W, 3] straight radiance under another light.
        specular: the same.
        captured: under the light of the plate.
        coverage: [H, W] 0..1.
    """
    edge = (coverage > 0) & (coverage < EDGE)
    out = np.array(diffuse, np.float32, order="C"), np.array(specular, np.float32, order="C")
    weight = np.square(np.asarray(coverage, dtype=np.float32))
    total = spread(weight, SIDE)
    for k in range(3 if edge.any() else 0):
        shiny = captured.specular[..., k]
        around = spread((captured.diffuse[..., k] + shiny) * weight, SIDE)
        told = edge & (around > _DARK * total)
        out[0][..., k][told] = (captured.plate[..., k] * spread(diffuse[..., k] * weight, SIDE))[told] / around[told]
        mean = spread(shiny * weight, SIDE) / np.maximum(total, np.float32(1e-12))
        bright = edge & (shiny > np.maximum(mean, np.float32(_DARK)))
        out[1][..., k][bright] *= mean[bright] / shiny[bright]
    return out
