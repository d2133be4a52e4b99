"""Normals at the silhouettes of a rendered field."""

import numpy as np
import pytest

from yesnt.gaussians.records import View
from yesnt.gaussians.silhouette import REACH, turned_at_silhouettes

SIDE = 96
VIEW = View(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0.0, -4, 0]), 120, 120, 48, 48, SIDE, SIDE)
"""Looks along +Y at the origin."""


def ball():
    """True normals and coverage of the unit ball, the distance of its pixels from the edge, and unit rays."""
    rays = VIEW.rays() @ VIEW.rotation
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    b = rays @ VIEW.position
    root = b**2 - (VIEW.position @ VIEW.position - 1)
    hit = root > 0
    normal = np.where(hit[..., None], VIEW.position + (-b - np.sqrt(np.maximum(root, 0)))[..., None] * rays, 0)
    radius = 120 / np.sqrt(15)  # of the silhouette: a ball of radius 1 at a distance of 4
    away = radius - np.hypot(*(np.mgrid[:SIDE, :SIDE] + 0.5 - 48))
    return normal.astype(np.float32), hit.astype(np.float32), away, rays


def degrees(one, other):
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=-1), -1, 1)))


def test_normals_that_face_the_camera_at_the_edge_turn_away_as_those_of_a_ball():
    true, matte, away, rays = ball()
    edge = (matte > 0) & (away < REACH)
    seen = np.where(edge[..., None], true - 0.8 * rays, true)
    seen /= np.maximum(np.linalg.norm(seen, axis=-1, keepdims=True), 1e-9)
    found = turned_at_silhouettes(seen.astype(np.float32), matte, VIEW)
    assert np.median(degrees(seen, true)[edge]) > 25
    assert np.median(degrees(found, true)[edge]) < 6
    assert np.allclose(np.linalg.norm(found[matte > 0], axis=1), 1, atol=1e-5)
    assert np.array_equal(found[~edge & (away > REACH + 1)], seen[~edge & (away > REACH + 1)].astype(np.float32))


@pytest.mark.parametrize("tilt", [0, 40, 70])
def test_the_edge_of_a_plane_keeps_its_normals(tilt):
    turn = np.radians(tilt)
    normal = np.zeros((SIDE, SIDE, 3), np.float32)
    matte = np.zeros((SIDE, SIDE), np.float32)
    matte[20:76, 30:70] = 1
    normal[matte > 0] = [np.sin(turn), -np.cos(turn), 0]
    assert np.array_equal(turned_at_silhouettes(normal, matte, VIEW), normal)


def test_the_border_of_the_picture_is_no_edge_and_small_subjects_stay():
    true, matte, _, _ = ball()
    full = np.broadcast_to(np.float32([0, -1, 0]), true.shape)
    assert np.array_equal(turned_at_silhouettes(full, np.ones_like(matte), VIEW), full)
    small = np.zeros_like(matte)
    small[40:46, 40:46] = 1
    lone = true * small[..., None]
    assert np.array_equal(turned_at_silhouettes(lone, small, VIEW), lone)
