"""A field that is moved as a rigid body onto another surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.gaussians.scenes import random_field
from yesnt.gaussians.rigid import moved, rigid_motion

TURN, SHIFT = Rotation.from_rotvec([0.02, -0.03, 0.08]).as_matrix(), np.array([0.03, -0.02, 0.01])


def test_a_body_is_brought_onto_its_new_surface_although_a_limb_moves_by_itself() -> None:
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(6000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    body = ways * [0.5, 0.3, 0.15] * (1 + 0.3 * np.sin(4 * ways[:, :1]))
    limb = body[:, 0] > 0.4
    there = body @ TURN.T + SHIFT + np.where(limb[:, None], [0, 0, 0.1], 0)
    rotation, shift = rigid_motion(body, there)
    before = np.linalg.norm(body[~limb] - there[~limb], axis=1).mean()
    after = np.linalg.norm((body @ rotation.T + shift - there)[~limb], axis=1).mean()
    assert after < 0.5 * before


def test_a_moved_field_has_moved_covariances() -> None:
    field = random_field(20)
    found = moved(field, TURN, SHIFT)
    assert np.allclose(found.positions, field.positions @ TURN.T + SHIFT, atol=1e-6)
    assert np.allclose(found.covariances, TURN @ field.covariances @ TURN.T, atol=1e-7)
    assert np.array_equal(found.harmonics, field.harmonics)
