"""How far off a cheaper way will be, told before it is taken (docs/relight.md, "Predicted error").

Light clusters: where one visibility stands for light from within an angle d, a shadow edge is off by about d; the
light's own angular radius r blurs that edge anyway. So the display error is about SHARE d / r, d being the mean over
the light and r the radius of the solid angle that holds half of it; a sun is a cluster of its own and stays out of r.

Bounces: what is hidden is shown by the share h of the sky that triangles see hidden, and each bounce keeps the albedo
a of it, so that bounce k is worth (a h)^k of the light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.tree import Box, doublings

F32 = NDArray[np.float32]
Float = NDArray[np.float64]

LEAST_CLUSTERS = 16

SHARE = 0.04
"""Display error over d / r; the measurements are in docs/relight.md."""

_SUN = 0.02  # of the light in one cell: it has a cluster of its own
_BRIGHTNESS = 0.25  # display step of a relative step of light, at mid grey


def enough_clusters(weights: Float, moments: Float, error: float, most: int) -> int:
    """The least of 16, 32, ... `most` whose predicted display error is at most `error`; `most` if none is.

    Args:
        weights: moments of importance that the tree is cut by (tree.importance).
        moments: of the cells (envmap.cell_moments).
        error: root mean square of display values.
        most: clusters.
    """
    count, radius = min(LEAST_CLUSTERS, most), light_radius(moments)
    for boxes in doublings(weights, count, most):
        count = min(len(boxes), most)
        if cluster_error(moments, boxes, radius) <= error:
            break
    return count


def cluster_error(moments: Float, boxes: list[Box], radius: float) -> float:
    """Predicted display error of one visibility for each box, for a light of that angular radius."""
    from yesnt.relight.texels import box_sums

    sums = box_sums(moments, boxes)
    light = luminance(sums[:, :3])
    mean = np.linalg.norm(sums[:, 3:6], axis=1) / np.maximum(light, 1e-300)
    apart = np.sqrt(2 * np.clip(1 - mean, 0, 1))
    return SHARE * float((light * apart).sum() / max(light.sum(), 1e-300)) / radius


def light_radius(moments: Float) -> float:
    """Angular radius of the solid angle that holds half of the light, suns left out, rad."""
    light, solid = luminance(moments[..., :3]).ravel(), moments[..., 6].ravel()
    soft = light < _SUN * light.sum()
    light, solid = light[soft], solid[soft]
    order = np.argsort(-light / solid, kind="stable")
    held = light[order].cumsum()
    if not len(held) or held[-1] <= 0:
        return 1.0
    return float(np.sqrt(solid[order].cumsum()[np.searchsorted(held, 0.5 * held[-1])] / np.pi))


def bounces_worth(hidden: float, albedo: float, error: float, most: int) -> int:
    """Bounces, at most `most`, each of which changes the display by a quarter of `error` or more.

    Args:
        hidden: mean share of the sky, by cosine, that triangles see hidden.
        albedo: mean of the triangles.
        error: display error that is allowed; 0 keeps all.
        most: bounces.
    """
    kept = max(hidden * albedo, 0.0)
    return sum(_BRIGHTNESS * kept**bounce >= 0.25 * error for bounce in range(1, most + 1))
