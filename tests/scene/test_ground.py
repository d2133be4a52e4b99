"""Where the ground is: fitted under the feet over the whole shot, and its mesh."""

from __future__ import annotations

import numpy as np
import pytest

from tests.relight.scenes import box_mesh
from yesnt.relight.proxy import ProxyScene
from yesnt.scene.ground import Ground, fit_ground, stance


def standing(height=0.0, x=0.0):
    return stance(*box_mesh((x - 0.2, -0.2, height), (x + 0.2, 0.2, height + 1.8)))


def test_the_contact_of_one_frame_is_its_sole():
    found = standing(0.03)
    assert found.contact == pytest.approx(0.03, abs=1e-3)
    assert (found.low, found.high) == ((pytest.approx(-0.2), pytest.approx(-0.2)), (pytest.approx(0.2),) * 2)


def test_a_stray_splinter_below_the_feet_is_no_contact():
    vertices, faces = box_mesh((-0.2, -0.2, 0), (0.2, 0.2, 1.8))
    splinter = np.float32([[0, 0, -0.5], [0.01, 0, -0.5], [0, 0.01, -0.49]])
    both = np.concatenate([vertices, splinter]), np.concatenate([faces, [[8, 9, 10]]]).astype(np.int32)
    assert stance(*both).contact == pytest.approx(0, abs=1e-3)


def test_frames_in_the_air_do_not_lift_the_ground_nor_does_one_bad_proxy_lower_it():
    jumps = [standing(h) for h in (0, 0, 0, 0.1, 0.3, 0.4, 0.3, 0.1, 0, 0, 0, 0)]
    assert fit_ground(jumps, None, 10).height == pytest.approx(0, abs=1e-3)
    assert fit_ground([*jumps, standing(-0.7)], None, 10).height == pytest.approx(0, abs=1e-3)


def test_a_given_height_is_kept_and_the_disc_holds_all_frames():
    found = fit_ground([standing(0, x) for x in (-3, 0, 5)], 0.25, 2)
    assert found.height == 0.25
    assert found.centre == (pytest.approx(1), pytest.approx(0))
    assert found.radius == pytest.approx(found.reach) == pytest.approx(np.hypot(4.2, 0.2))


def test_the_mesh_is_the_disc_facing_up():
    ground = Ground(0.5, (1.0, 2.0), 0.7, 10.0)
    mesh = ProxyScene.from_arrays(*ground.mesh())
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * len(mesh.faces), atol=1e-6)
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area == pytest.approx(np.pi * 100, rel=0.01)
    assert np.hypot(*(mesh.vertices[:, :2] - [1, 2]).T).max() == pytest.approx(10)


def test_the_ground_fades_from_half_its_radius_on():
    ground = Ground(0.0, (1.0, 0.0), 0.5, 10.0)
    points = np.float32([[1, 0, 0], [6, 0, 0], [8.5, 0, 0], [11, 0, 0], [1, -30, 0]])
    np.testing.assert_allclose(ground.cover(points), [1, 1, 0.5, 0, 0], atol=1e-6)
