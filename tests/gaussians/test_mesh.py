"""The proxy mesh of a field: opacity at points, marching tetrahedra, the whole extraction on a field of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gaussians.scenes import camera_at, shell
from yesnt.gaussians.mesh import extract_mesh, largest_parts, smooth
from yesnt.gaussians.mesh_settings import MeshSettings
from yesnt.gaussians.opacity import ellipsoids, opacity_at, opacity_reference
from yesnt.gaussians.records import SURFACE
from yesnt.gaussians.tetrahedra import march

EYES = [(1.2, 0.2, 0.3), (-1.0, 1.0, -0.5), (0.0, -1.3, 0.6), (0.1, 0.3, 1.4), (0.2, 0.1, -1.4)]
CAMERAS = [(camera_at(eye, focal=20), None) for eye in EYES]


def points_near(count: int, seed: int) -> np.ndarray:
    """Points [P, 3] about a shell of radius 0.3, all of them in the pictures of `CAMERAS`."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(count, 3))
    return ways / np.linalg.norm(ways, axis=1, keepdims=True) * rng.uniform(0.1, 0.42, (count, 1))


def test_opacity_is_that_of_the_reference() -> None:
    shapes = ellipsoids(shell(60))
    points = points_near(150, 0)
    for camera, _ in CAMERAS:
        found = opacity_at(points, shapes, [(camera, None)])
        expected = opacity_reference(points, shapes, camera.position())
        assert np.abs(found - expected).max() < 2e-4  # the renderer's transmittance at which it stops
        assert 0.2 < (expected > 0.5).mean() < 0.95


def test_opacity_is_the_least_over_cameras_and_ignores_those_that_do_not_show_a_point() -> None:
    shapes = ellipsoids(shell(60))
    points = points_near(50, 1)
    each = [opacity_at(points, shapes, [camera]) for camera in CAMERAS]
    assert np.array_equal(opacity_at(points, shapes, CAMERAS), np.min(each, axis=0))
    beside = np.array([[0.0, 50.0, 0.0], [2.4, 0.4, 0.6]])  # outside the picture; behind the camera
    assert opacity_at(beside, shapes, CAMERAS[:1]).tolist() == [1, 1]


def test_a_level_tells_the_side_exactly() -> None:
    shapes = ellipsoids(shell(200))
    points = points_near(400, 2)
    exact = opacity_at(points, shapes, CAMERAS)
    assert np.array_equal(opacity_at(points, shapes, CAMERAS, 0.5) >= 0.5, exact >= 0.5)


def cubes(count: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """A grid of points and five-sided cubes cut into six tetrahedra each."""
    from scipy.spatial import Delaunay

    axis = np.linspace(-1, 1, count)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    points += np.random.default_rng(0).normal(0, 1e-3, points.shape)
    return points, Delaunay(points).simplices


def test_marching_tetrahedra_close_the_surface_and_face_outward() -> None:
    import trimesh

    points, tetrahedra = cubes()
    crossing = march(points, tetrahedra, np.linalg.norm(points, axis=1) < 0.8)
    middle = 0.5 * (points[crossing.inside] + points[crossing.outside])
    mesh = trimesh.Trimesh(middle, crossing.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert 0.8 < mesh.volume / (4 / 3 * np.pi * 0.8**3) < 1.2


@pytest.mark.parametrize("inside", range(1, 15))
def test_every_case_of_a_tetrahedron_separates_inside_from_outside(inside: int) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mask = np.array([bool(inside >> k & 1) for k in range(4)])
    found = march(points, np.arange(4)[None], mask)
    middle = 0.5 * (points[found.inside] + points[found.outside])
    assert len(found.faces) == (2 if mask.sum() == 2 else 1)
    for face in found.faces:
        a, b, c = middle[face]
        side = (points - a) @ np.cross(b - a, c - a)
        assert (side[mask] < 0).all()
        assert (side[~mask] > 0).all()


def test_a_shell_becomes_a_closed_sphere_of_its_radius() -> None:
    import trimesh

    mesh = extract_mesh(shell(400, 0.3), CAMERAS, MeshSettings(triangles=800, level=0.5))
    found = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    radius = np.linalg.norm(mesh.vertices, axis=1)
    assert len(mesh.faces) <= 800
    assert found.is_watertight
    assert found.is_winding_consistent
    assert 1 < radius.mean() / 0.3 < 1.04  # flat discs that touch a sphere stand out at their rims
    assert radius.std() < 0.01 * 0.3
    assert found.volume > 0


def test_a_lower_level_lies_farther_out_by_part_of_the_discs_thickness() -> None:
    field = shell(400, 0.3)
    radii = [
        np.linalg.norm(extract_mesh(field, CAMERAS, MeshSettings(triangles=800, level=level)).vertices, axis=1).mean()
        for level in (0.5, SURFACE)
    ]
    thickness = np.exp(field.log_scales[0, 2])
    assert 0 < radii[1] - radii[0] < thickness


def test_small_parts_are_dropped_and_an_empty_field_gives_no_triangles() -> None:
    import trimesh

    large, small = trimesh.creation.icosphere(2, 1.0), trimesh.creation.icosphere(1, 0.05)
    both = trimesh.util.concatenate([small, large])
    vertices, faces = largest_parts(np.asarray(both.vertices), np.asarray(both.faces), 0.02)
    assert (len(vertices), len(faces)) == (len(large.vertices), len(large.faces))
    faint = shell(20, logit=-8.0)
    assert len(extract_mesh(faint, CAMERAS).faces) == 0


def test_smoothing_takes_noise_and_keeps_the_size() -> None:
    import trimesh

    sphere = trimesh.creation.icosphere(3, 1.0)
    noisy = np.asarray(sphere.vertices) + np.random.default_rng(0).normal(0, 0.02, sphere.vertices.shape)
    radius = np.linalg.norm(smooth(noisy, np.asarray(sphere.faces), 5), axis=1)
    assert radius.std() < 0.5 * np.linalg.norm(noisy, axis=1).std()
    assert abs(radius.mean() - 1) < 0.005
