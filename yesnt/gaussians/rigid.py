"""Moves the field of one moment onto the surface of another as a rigid body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.field import GaussianField, rotation_matrices

F64 = NDArray[np.float64]

ROUNDS = 40


def rigid_motion(source: F64, surface: F64, rounds: int = ROUNDS) -> tuple[F64, F64]:
    """Rotation [3, 3] and translation [3] that take points [N, 3] onto points [M, 3] of a surface.

    Iterative closest points (Besl and McKay 1992), trimmed: the farther half of each round's pairs is left out, so that
    limbs that moved by themselves do not turn the body.
    """
    from scipy.spatial import cKDTree

    tree, rotation, shift = cKDTree(surface), np.eye(3), np.zeros(3)
    for _ in range(rounds):
        distance, nearest = tree.query(source @ rotation.T + shift)
        near = distance <= np.median(distance)
        a, b = source[near], surface[nearest[near]]
        u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
        rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
        shift = b.mean(axis=0) - rotation @ a.mean(axis=0)
    return rotation, shift


def moved(field: GaussianField, rotation: F64, shift: F64) -> GaussianField:
    """A field after a rigid motion. Colours by direction stay: the light does not turn with the subject."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(rotation @ rotation_matrices(field.rotations)).as_quat()[:, [3, 0, 1, 2]]
    positions = field.positions.astype(np.float64) @ rotation.T + shift
    return replace(field, positions=positions.astype(np.float32), rotations=turned.astype(np.float32))
