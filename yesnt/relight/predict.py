"""Predicted display error of shortcuts, before they are taken (docs/relight.md, "Predicted error").

Light clusters: if one visibility represents light from within an angle d, a shadow edge is displaced by up to about d.
The angular radius r of the light blurs that edge anyway. So the display error is about SHARE d / r, with d the mean
over the light and r the radius of the solid angle that holds half of the light. A sun has a cluster of its own and is
left out of r.

Bounces: a share h of the sky is occluded for the triangles of the proxy, and each bounce multiplies by the albedo a, so
that bounce k contributes (a h)^k of the light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.tree import Box, doublings

F32 = NDArray[np.float32]
Float = NDArray[np.float64]

LEAST_CLUSTERS = 16
"""Clusters that are always made."""

SHARE = 0.04
"""Display error over d / r, fitted to the measurements in docs/relight.md."""

_SUN = 0.02  # share of the light in one cell from which it is a sun
_BRIGHTNESS = 0.25  # derivative of the display value by the logarithm of radiance, at mid grey


def enough_clusters(weights: Float, moments: Float, error: float, most: int) -> int:
    """Smallest of 16, 32, ... `most` clusters whose predicted display error is at most `error`; else `most`.

    Args:
        weights: [h, w, 4] of `tree.importance`.
        moments: [h, w, 10] of `envmap.cell_moments`.
        error: allowed root mean square error of display values.
        most: largest number of clusters.
    """
    count, radius = min(LEAST_CLUSTERS, most), light_radius(moments)
    for boxes in doublings(weights, count, most):
        count = min(len(boxes), most)
        if cluster_error(moments, boxes, radius) <= error:
            break
    return count


def cluster_error(moments: Float, boxes: list[Box], radius: float) -> float:
    """Predicted display error of one visibility per box.

    Args:
        moments: [h, w, 10] of `envmap.cell_moments`.
        boxes: cells of each cluster.
        radius: angular radius of the light, rad (`light_radius`).
    """
    from yesnt.relight.texels import box_sums

    sums = box_sums(moments, boxes)
    light = luminance(sums[:, :3])
    mean = np.linalg.norm(sums[:, 3:6], axis=1) / np.maximum(light, 1e-300)
    apart = np.sqrt(2 * np.clip(1 - mean, 0, 1))
    return SHARE * float((light * apart).sum() / max(light.sum(), 1e-300)) / radius


def light_radius(moments: Float) -> float:
    """Angular radius, rad, of the smallest solid angle that holds half of the light without suns; 1 without light."""
    light, solid = luminance(moments[..., :3]).ravel(), moments[..., 6].ravel()
    soft = light < _SUN * light.sum()
    light, solid = light[soft], solid[soft]
    order = np.argsort(-light / solid, kind="stable")
    held = light[order].cumsum()
    if not len(held) or held[-1] <= 0:
        return 1.0
    return float(np.sqrt(solid[order].cumsum()[np.searchsorted(held, 0.5 * held[-1])] / np.pi))


def bounces_worth(hidden: float, albedo: float, error: float, most: int) -> int:
    """Number of bounces, at most `most`, that each change the display by at least a quarter of `error`.

    Args:
        hidden: mean cosine-weighted share of the sky that is occluded for triangles.
        albedo: mean albedo of the triangles.
        error: allowed display error; 0 keeps all bounces.
        most: largest number of bounces.
    """
    kept = max(hidden * albedo, 0.0)
    return sum(_BRIGHTNESS * kept**bounce >= 0.25 * error for bounce in range(1, most + 1))
