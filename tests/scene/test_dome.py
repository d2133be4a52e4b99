"""The light's map on a dome with a ground."""

from __future__ import annotations

import numpy as np
import pytest

from tests.scene.set_scenes import camera
from yesnt.relight.envmap import EnvMap
from yesnt.scene.dome import Dome


def map_of_directions():
    """A map whose radiance is its own direction, moved to be positive."""
    from yesnt.relight.envmap import uv_to_direction

    v, u = (np.arange(256) + 0.5) / 256, (np.arange(512) + 0.5) / 512
    return EnvMap.from_array((uv_to_direction(u, v[:, None]) + 1).astype(np.float32))


def test_a_point_of_the_ground_shows_what_the_map_saw_there():
    cam, place = camera(), np.array([1.0, 2.0, 1.5])
    found = Dome((1.0, 2.0, 1.5), 0.0, 50.0).picture(map_of_directions(), cam, 1) - 1
    rays, eye = cam.rays(1).astype(np.float64), cam.position(1)
    down = rays[..., 2] < -0.1
    point = eye + rays * (-eye[2] / np.where(down, rays[..., 2], -1))[..., None]
    expected = (point - place) / np.linalg.norm(point - place, axis=-1, keepdims=True)
    assert down.sum() > 100
    np.testing.assert_allclose(found[down], expected[down], atol=0.01)


def test_far_away_it_is_the_map_itself():
    cam = camera()
    env = map_of_directions()
    found = Dome((0.0, -4.0, 2.0), 0.0, 1e6).picture(env, cam, 1)
    np.testing.assert_allclose(found, env.lookup(cam.rays(1)), atol=1e-3)


def test_an_eye_beyond_the_dome_sees_it_from_just_inside():
    found = Dome((0.0, 0.0, 0.5), 0.0, 1.0).picture(map_of_directions(), camera(), 1)
    assert np.isfinite(found).all()
    assert found.min() >= 0 == pytest.approx(0)
