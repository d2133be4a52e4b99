from dataclasses import replace

import numpy as np
import pytest

from tests.capture.balls import around_balls, coverage, ring, silhouettes
from tests.decompose.evidence.scenes import FRAME, look_from
from yesnt.capture.carving import FAR, GridRecord, carve, pinhole_record, signed_distance
from yesnt.capture.hull import edge_distance, visual_hull
from yesnt.core.distortion import Distortion


@pytest.fixture(scope="module")
def ball():
    return visual_hull(silhouettes(around_balls(24)), resolution=48)


def test_the_hull_of_a_ball_is_the_ball(ball) -> None:
    radius = np.linalg.norm(ball.points, axis=1)
    assert radius.min() > 0.985, "a hull holds its subject"
    assert abs(np.median(radius) - 1) < 0.005
    assert radius.max() < 1.06, "between cameras it stands out"
    outward = (ball.points * ball.normals).sum(axis=1) / radius
    assert outward.min() > 0.9
    assert np.median(outward) > 0.998
    assert np.allclose(np.linalg.norm(ball.normals, axis=1), 1, atol=1e-5)


def test_points_are_about_one_step_apart(ball) -> None:
    from scipy.spatial import cKDTree

    nearest = cKDTree(ball.points).query(ball.points, k=2)[0][:, 1]
    assert 0.4 < np.median(nearest) / ball.spacing < 1.1
    assert len(ball.points) == pytest.approx(4 * np.pi / ball.spacing**2 * 1.5, rel=0.15)


def test_its_mesh_is_closed_and_faces_outward(ball) -> None:
    import trimesh

    mesh = trimesh.Trimesh(*ball.mesh())
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi, rel=0.02)


def test_the_order_of_the_cameras_changes_no_bit(ball) -> None:
    views = silhouettes(around_balls(24))
    again = visual_hull(views[::-1], resolution=48)
    assert again.points.tobytes() == ball.points.tobytes()
    assert again.normals.tobytes() == ball.normals.tobytes()


def test_more_cameras_never_add_to_the_hull() -> None:
    views = silhouettes(around_balls(12), size=64)
    grid = GridRecord(np.full(3, -1.3), 0.1)
    field, count = np.full((27, 27, 27), FAR, np.float32), np.zeros((27, 27, 27), np.uint8)
    for view in views:
        before = field.copy()
        carve(field, count, grid, pinhole_record(view.camera, view.pose), edge_distance(view.matte))
        assert (field <= before).all()
    assert (field < 0).any(axis=(1, 2)).all()


def test_the_kernel_agrees_with_the_reference() -> None:
    view = silhouettes([(1, -2, 0.5)], size=33)[0]
    grid = GridRecord(np.array([-1.2, -1.3, -1.1]), 0.21)
    field, count = np.full((9, 12, 10), FAR, np.float32), np.zeros((9, 12, 10), np.uint8)
    signed = edge_distance(view.matte)
    carve(field, count, grid, pinhole_record(view.camera, view.pose), signed)
    points = grid.origin + grid.step * np.stack(np.indices(field.shape), axis=-1)
    expected, seen = signed_distance(points, view.camera, view.pose, signed)
    assert np.array_equal(count, seen)
    assert np.allclose(field[seen], expected[seen], atol=1e-5)
    assert (field[~seen] == FAR).all()


def test_what_a_camera_does_not_have_in_its_picture_it_does_not_carve() -> None:
    views = silhouettes(around_balls(12), size=64)
    narrow = look_from((0, -1, 0), 64)
    narrow = replace(narrow, width=20, cx=10.0)  # the middle of the ball only
    cut = [*views, replace(views[0], name="narrow", camera=narrow, matte=coverage(narrow))]
    radius = np.linalg.norm(visual_hull(cut, 40).points, axis=1)
    assert radius.min() > 0.97


def test_small_components_are_left_out() -> None:
    balls = (((0, 0, 0), 1.0), ((0.0, 0.0, 1.35), 0.1))
    hull = visual_hull(silhouettes(around_balls(16), balls=balls), 48)
    assert hull.points[:, 2].max() < 1.2


def test_components_that_few_cameras_see_are_left_out() -> None:
    """Four narrow pictures: behind the ball as a camera sees it, two silhouettes cross where the others see nothing."""
    views = silhouettes(ring(4), 64, (((0.0, 0.0, 0.0), 0.5),), distance=2.2)
    hull = visual_hull(views, 48)
    assert np.linalg.norm(hull.points, axis=-1).max() < 0.95
    assert hull.seen[hull.field > 0].min() == 4


def test_thin_limbs_survive_the_coarse_grids() -> None:
    pole = tuple(((0.0, 0.0, z), 0.04) for z in np.linspace(-0.8, 0.8, 60))
    hull = visual_hull(silhouettes(ring(8), 96, pole), 48)
    assert hull.points[:, 2].min() < -0.78
    assert hull.points[:, 2].max() > 0.78


def test_silhouettes_that_agree_nowhere_give_an_empty_hull() -> None:
    views = silhouettes(ring(4), size=32)
    hull = visual_hull([replace(view, matte=0 * view.matte) for view in views], 24)
    assert hull.empty
    assert hull.normals.shape == (0, 3)


def test_cameras_without_a_common_view_are_refused() -> None:
    away = look_from((0, 1, 0), 32)
    pose = away.pose(FRAME).copy()
    pose[:3, 3] -= [0, 30, 0]
    views = silhouettes([(1, 0, 0)], 32)
    other = replace(views[0], name="c01", camera=replace(away, poses={FRAME: pose}))
    with pytest.raises(ValueError, match="no point is in the pictures of 2 of 2 cameras"):
        visual_hull([views[0], other], 24)


def test_a_distorting_camera_is_refused() -> None:
    view = silhouettes([(1, 0, 0)], 32)[0]
    bent = replace(view, camera=replace(view.camera, distortion=Distortion("brown", (0.1, 0, 0, 0))))
    with pytest.raises(ValueError, match="without distortion"):
        visual_hull([bent], 24)


def test_coverage_places_the_edge_to_a_tenth_of_a_pixel() -> None:
    matte = np.zeros((5, 12), np.float32)
    matte[:, 6:] = 1
    matte[:, 5] = 0.75
    signed = edge_distance(matte)[2]
    crossing = np.interp(0, signed, np.arange(12) + 0.5)
    assert crossing == pytest.approx(5.25, abs=0.1)
