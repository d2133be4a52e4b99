import numpy as np
import pytest

from tests.decompose.evidence.scenes import FRAME, around, look_from
from yesnt.capture.choose import NEAR, cameras_that_see, choose_cameras
from yesnt.core.errors import JobError
from yesnt.io.cameras import CalibratedCamera

PLATE = look_from([0, -1, 0], 32)


def rig(directions):
    return {f"c{i:02d}": CalibratedCamera(look_from(way, 32), still=False) for i, way in enumerate(directions)}


def ring(count, elevation=0.0):
    azimuth = np.linspace(-np.pi, np.pi, count, endpoint=False)
    flat = np.cos(np.radians(elevation))
    up = np.full(count, np.sin(np.radians(elevation)))
    return np.stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, up], axis=1)


def angles(cameras, names):
    ways = [cameras[name].camera.position(FRAME) for name in names]
    ways = np.stack([way / np.linalg.norm(way) for way in ways])
    return np.degrees(np.arccos(np.clip(ways @ ways.T, -1, 1)))


def test_cameras_are_spread_over_azimuth_and_elevation() -> None:
    cameras = rig(np.concatenate([ring(24), ring(12, 45), ring(12, -30)]))
    chosen = choose_cameras(cameras, PLATE, FRAME, np.zeros(3), 8)
    assert len(chosen) == 8
    heights = [cameras[name].camera.position(FRAME)[2] for name in chosen]
    assert min(heights) < -1
    assert max(heights) > 1
    apart = angles(cameras, chosen)
    assert apart[~np.eye(8, dtype=bool)].min() > 20
    near = [angles({**cameras, "plate": CalibratedCamera(PLATE, still=False)}, [n, "plate"])[0, 1] for n in chosen]
    assert max(near) <= NEAR, "cameras that look at the other side measure nothing of the plate"


def test_all_cameras_on_one_side_are_taken_nearest_last() -> None:
    cameras = rig([(1, -1, 0), (1, -0.98, 0), (1, -0.5, 0.1)])
    assert set(choose_cameras(cameras, PLATE, FRAME, np.zeros(3), 2)) != {"c00", "c01"}
    assert len(choose_cameras(cameras, PLATE, FRAME, np.zeros(3), 12)) == 3


def test_the_camera_that_took_the_plate_does_not_count_twice() -> None:
    cameras = rig([(0, -1, 0), *around(3)])
    assert "c00" not in choose_cameras(cameras, PLATE, FRAME, np.zeros(3), 12)


def test_a_camera_that_looks_away_does_not_see() -> None:
    cameras = rig(around(3))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    assert list(cameras_that_see(cameras, FRAME, corners, "f")) == list(cameras)
    assert not cameras_that_see(cameras, FRAME, corners + np.array([0, 0, 50.0]), "f")


def test_a_moving_camera_without_a_pose_is_named() -> None:
    with pytest.raises(JobError, match="Camera c00 of the capture has no pose for frame 9"):
        cameras_that_see(rig(around(2)), 9, np.zeros((1, 3)), "cameras.json")
