"""Camera paths around a field."""

from __future__ import annotations

import numpy as np

from tests.gaussians.scenes import camera_at, shell
from yesnt.gaussians.orbit import between, bounds, cameras_around, orbit


def test_an_orbit_keeps_distance_elevation_and_what_it_looks_at() -> None:
    camera, centre = camera_at((1.0, 0.4, 0.5)), np.zeros(3)
    path = orbit(camera, None, centre, 6)
    assert list(path.poses) == [1, 2, 3, 4, 5, 6]
    assert np.allclose(path.pose(1), camera.pose())
    for frame in path.poses:
        place = path.position(frame)
        assert np.isclose(np.linalg.norm(place), np.linalg.norm(camera.position()))
        assert np.isclose(place[2], 0.5)
        assert np.allclose(path.project(centre[None], frame)[0, :2], camera.project(centre[None])[0, :2])
    assert np.allclose(path.position(4)[:2], -path.position(1)[:2])


def test_a_path_passes_its_stops_and_looks_at_the_centre_on_the_way() -> None:
    stops = [(camera_at(eye), None) for eye in ((1.0, 0.0, 0.3), (0.0, 2.0, 0.3), (-1.5, 0.0, 0.3))]
    path = between(stops, np.zeros(3), 5)
    for frame, stop in zip((1, 3, 5), stops, strict=True):
        assert np.allclose(path.pose(frame), stop[0].pose(), atol=1e-9)
    middle = path.position(2)
    lengths = [np.linalg.norm(stop[0].position()) for stop in stops]
    assert np.isclose(np.linalg.norm(middle), 0.5 * (lengths[0] + lengths[1]))
    x, y, _ = path.project(np.zeros((1, 3)), 2)[0]
    assert np.allclose([x, y], [12, 8])


def test_views_from_all_sides_hold_the_whole_field() -> None:
    field = shell(200, 0.4)
    centre, radius = bounds(field)
    assert np.allclose(centre, 0, atol=0.01)
    cameras = cameras_around(field)
    ways = np.stack([camera.position() for camera, _ in cameras])
    assert np.linalg.norm(ways.mean(axis=0)) < 0.05 * np.linalg.norm(ways[0])
    for camera, frame in cameras:
        x, y, z = camera.project(field.positions, frame).T
        assert ((x > 0) & (x < camera.width) & (y > 0) & (y < camera.height) & (z > radius)).all()
