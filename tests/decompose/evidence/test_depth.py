"""Points that z and the proxy place differently: laws on a plane, whose depth is known."""

import numpy as np
import pytest

from yesnt.core.camera import Camera
from yesnt.decompose.evidence.depth import LEAST_COSINE, on_proxy, planar_depth, slope
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight import ProxyScene, Surface

SETTINGS = EvidenceSettings()
SIZE, FAR, EXTENT = 12, 3.0, 2.0
"""Pixels, metres to the wall, and metres that its proxy is large."""


def wall():
    """A square before a camera that looks along +z."""
    half = EXTENT / 2
    corners = [[-half, -half, FAR], [half, -half, FAR], [half, half, FAR], [-half, half, FAR]]
    return ProxyScene.from_arrays(corners, [[0, 2, 1], [0, 3, 2]])


def surface(z):
    camera = Camera(SIZE, SIZE, 2.0 * SIZE, 2.0 * SIZE, SIZE / 2, SIZE / 2, {1: np.eye(4)})
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    normal[..., 2] = -1
    full = np.ones((SIZE, SIZE), np.float32)
    return Surface(normal, np.float32(z) * full, full, 0.5 * full, 0 * full, camera, 1)


def test_planar_depth_of_a_wall_is_its_distance_for_every_ray_and_0_beside_it() -> None:
    rays = np.float32([[0, 0, 1], [0.3, -0.2, 1], [-0.1, 0.3, 1], [0.5, 0, 1]])
    np.testing.assert_allclose(planar_depth(wall(), np.zeros(3), rays), [FAR, FAR, FAR, 0], rtol=1e-5)
    np.testing.assert_allclose(planar_depth(wall(), np.array([0, 0, 1.0]), rays[:1]), FAR - 1, rtol=1e-5)


@pytest.mark.parametrize("degrees", [0, 30, 60, 80])
def test_the_slope_is_the_tangent_of_the_angle_to_the_normal(degrees) -> None:
    angle = np.radians(degrees)
    assert slope(np.cos(angle)) == pytest.approx(np.tan(angle), abs=1e-6)
    assert slope(np.array(0.0)) == pytest.approx(1 / LEAST_COSINE)


@pytest.mark.parametrize(("share", "moves"), [(0.4, False), (0.6, True), (-0.6, True), (5, True), (30, False)])
def test_points_move_to_the_proxy_beyond_half_of_depth_and_within_a_tenth_of_its_size(share, moves) -> None:
    z = FAR + share * SETTINGS.depth * EXTENT
    found, moved = on_proxy(surface(z), wall(), EXTENT, SETTINGS)
    assert moved.all() == moved.any() == moves
    np.testing.assert_allclose(found.z, FAR if moves else z, rtol=1e-5)


def test_where_the_proxy_is_missed_or_nothing_is_covered_z_stands() -> None:
    tiny = ProxyScene.from_arrays([[-0.2, -0.2, FAR], [0.2, -0.2, FAR], [0, 0.2, FAR]], [[0, 2, 1]])
    given = surface(FAR + 0.03)
    given.opacity[:6] = 0
    found, moved = on_proxy(given, tiny, EXTENT, SETTINGS)
    assert 0 < moved.sum() < SIZE * SIZE / 2
    assert not moved[:6].any()
    np.testing.assert_array_equal(found.z[~moved], given.z[~moved])
