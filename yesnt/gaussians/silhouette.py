"""Normals at silhouettes: a field's own face the camera there, those of a smooth surface turn away from it.

Gaussians that a ray grazes are discs seen from the side; their response along the ray is highest where they face it, so
the composited normals of the last pixels before the edge of the matte are tens of degrees off and glint when relit. A
smooth surface is perpendicular to the ray at its silhouette, and the cosine to the ray rises with the square root of
the distance from it, as on a sphere. Measured in docs/gaussians.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from yesnt.gaussians.records import View

F32 = NDArray[np.float32]

REACH = 3.0
"""Pixels from the edge of the matte in which normals are replaced."""

DEEPER = 6.0
"""Pixels from the edge at which a surface that curves towards its silhouette faces the camera more than at `REACH`."""

CURVED = 0.97
"""Ratio of the cosines at `REACH` and `DEEPER` below which the surface curves towards the edge; else it ends there."""

ALIGNED = 0.5
"""Least cosine between the outward direction of the edge and that in which the surface turns away, both in the picture:
elsewhere the edge is that of a sheet, or a crease."""

_BLUR = 1.0  # pixels: standard deviation in which the outward direction of the matte is measured
_LEAST = 0.02  # share of `REACH` that the outermost pixels count as, so that no normal is wholly perpendicular


def turned_at_silhouettes(normal: F32, alpha: F32, view: View) -> F32:
    """Normals [H, W, 3] that turn away from the camera towards the edge of the matte where the surface is smooth.

    Args:
        normal: [H, W, 3] unit world normals that face the camera; 0 where nothing is.
        alpha: [H, W] coverage.
        view: the camera.
    """
    inside = alpha > 0.5
    away = (
        np.where(inside, distance_transform_edt(inside) - 0.5, 0) if not inside.all() else np.full(alpha.shape, np.inf)
    )
    if not (away >= DEEPER).any():
        return normal
    rays = view.rays() @ view.rotation
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    outward = _outward(alpha, rays, view)
    near, near_cosine = _carried(normal, rays, away >= REACH)
    _, deep_cosine = _carried(normal, rays, away >= DEEPER)
    turning = _unit(near + near_cosine[..., None] * rays)
    smooth = ((turning * outward).sum(axis=-1) > ALIGNED) & (near_cosine < CURVED * deep_cosine)
    cosine = near_cosine * np.sqrt(np.clip(away / REACH, _LEAST, 1))
    turned = np.sqrt(1 - cosine**2)[..., None] * outward - cosine[..., None] * rays
    replaced = (alpha > 0) & (away < REACH) & smooth & normal.any(axis=-1)
    return np.where(replaced[..., None], turned, normal).astype(np.float32)


def _outward(alpha: F32, rays: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Unit directions [H, W, 3] in the world, perpendicular to the rays, in which coverage falls fastest."""
    down, right = np.gradient(gaussian_filter(alpha.astype(np.float64), _BLUR))
    slope = -(right[..., None] * view.rotation[0] + down[..., None] * view.rotation[1])
    return _unit(slope - (slope * rays).sum(axis=-1, keepdims=True) * rays)


def _carried(
    normal: F32, rays: NDArray[np.float64], source: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of the nearest pixel of `source`: its normal [H, W, 3], and that normal's cosine to this pixel's ray [H, W]."""
    rows, columns = distance_transform_edt(~source, return_distances=False, return_indices=True)
    taken = normal[rows, columns].astype(np.float64)
    return taken, np.clip(-(taken * rays).sum(axis=-1), 0, 1)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 1e-12, length, 1))
