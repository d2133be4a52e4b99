"""The field that a frame between keyframes starts from: a keyframe's, brought onto the frame's visual hull.

The body is moved as a rigid one. Limbs that moved by themselves are then where the hull is not, and missing where it
is: Gaussians outside the hull are removed, and discs are put on the hull where cameras look through the field at what
their mattes cover. Where the field merely lies inside the hull, as in a concavity, nothing is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.composite import ALPHA
from yesnt.gaussians.field import ARRAYS, GaussianField, rotation_matrices
from yesnt.gaussians.fit_state import FITTED
from yesnt.gaussians.initial import discs
from yesnt.gaussians.rasterise import arrays_of, pinhole_of, rasterise
from yesnt.gaussians.rigid import moved, rigid_motion
from yesnt.gaussians.settings import FitSettings
from yesnt.gaussians.targets import Target

Bool = NDArray[np.bool_]
F64 = NDArray[np.float64]

OUTSIDE = 2.0
"""Distance from the hull beyond which a Gaussian is removed, in steps of the hull's grid."""

WITNESSES = 2
"""Cameras that must look through the field at a point for a disc to be put there: one may have a bad matte."""

OPEN = 0.5
"""Opacity of the field below which a camera looks through it, and coverage above which it should not."""


def continued(
    field: GaussianField, points: F64, normals: F64, spacing: float, targets: Sequence[Target], settings: FitSettings
) -> GaussianField:
    """A keyframe's field as another frame's start.

    Args:
        field: of the keyframe.
        points: [P, 3] of the frame's visual hull, world metres.
        normals: [P, 3] outward unit normals.
        spacing: step of the hull's grid, metres.
        targets: the frame's pictures.
        settings: of the fit; `count` is the number of discs that would cover the whole hull.
    """
    start = moved(field, *rigid_motion(field.positions.astype(np.float64), points))
    start = chosen(start, ~outside(start.positions, points, normals, OUTSIDE * spacing))
    cover = discs(points, normals, targets, settings.count, settings.degree, settings.seed, field.color_space)
    return joined(start, chosen(cover, uncovered(cover, start, targets, settings.near)))


def outside(positions: NDArray[np.floating], points: F64, normals: F64, distance: float) -> Bool:
    """[N] positions that lie farther than a distance outside of a surface of points and outward normals."""
    from scipy.spatial import cKDTree

    far, nearest = cKDTree(points).query(positions)
    away = ((positions - points[nearest]) * normals[nearest]).sum(axis=1) > 0
    return np.asarray((far > distance) & away)


def uncovered(cover: GaussianField, field: GaussianField, targets: Sequence[Target], near: float) -> Bool:
    """[C] discs that face cameras which look through a field there, although their mattes cover it."""
    normals = rotation_matrices(cover.rotations)[:, :, 2]
    positions, witnesses = cover.positions.astype(np.float64), np.zeros(cover.count, int)
    for target in targets:
        view = target.view
        raster = rasterise(arrays_of(field), pinhole_of(view, field.positions.mean(axis=0, dtype=np.float64), near))
        through = (raster.images[ALPHA] < OPEN) & (target.matte > OPEN)
        local = (positions - view.position) @ view.rotation.T
        facing = (((view.position - positions) * normals).sum(axis=1) > 0) & (local[:, 2] > near)
        z = np.where(facing, local[:, 2], 1)
        x = np.floor(view.fx * local[:, 0] / z + view.cx).astype(int)
        y = np.floor(view.fy * local[:, 1] / z + view.cy).astype(int)
        seen = facing & (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height)
        witnesses += seen & through[np.where(seen, y, 0), np.where(seen, x, 0)]
    return np.asarray(witnesses >= min(WITNESSES, len(targets)))


def chosen(field: GaussianField, which: Bool) -> GaussianField:
    """Some of the Gaussians of a field."""
    arrays: dict[str, Any] = {name: getattr(field, name) for name in ARRAYS}
    some: dict[str, Any] = {name: None if array is None else array[which] for name, array in arrays.items()}
    return replace(field, **some)


def joined(first: GaussianField, second: GaussianField) -> GaussianField:
    """The Gaussians of two fields without smoothing filters, of one degree and colour space."""
    arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in (first, second)]) for name in FITTED}
    return replace(first, **arrays)
