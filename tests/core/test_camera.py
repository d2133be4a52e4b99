"""The camera model: axes, units, lenses of frames, distortion in rays and projection, and what it refuses."""

import json

import numpy as np
import pytest

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.io.cameras import read_cameras

POSE = np.array([[1, 0, 0, 0.2], [0, 0, 1, -3], [0, -1, 0, 1.5], [0, 0, 0, 1.0]])
OPENGL = POSE * [1, -1, -1, 1]
BROWN = {"model": "brown", "k": [-0.2, 0.05, 0.001, -0.0005]}


def document(pose=POSE, frames=("1001",), **changes):
    poses = {frame: {"world_from_camera": np.ravel(pose).tolist()} for frame in frames}
    return {"width": 32, "height": 24, "fx": 30.0, "fy": 31.0, "cx": 16.2, "cy": 11.5, "frames": poses} | changes


def seen_pixels(camera, frame=1001):
    """Pixels at which the camera projects what its own rays meet at 2 m: [H, W, 2]."""
    points = camera.position(frame) + 2 * camera.rays(frame).astype(np.float64)
    return camera.project(points, frame)[..., :2]


def centres(camera):
    return np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), -1)


@pytest.mark.parametrize("axes", ["opengl", "blender"])
def test_cameras_that_look_along_minus_z_are_turned(axes):
    plain, turned = Camera.from_dict(document()), Camera.from_dict(document(OPENGL, axes=axes))
    np.testing.assert_array_equal(turned.rays(1001), plain.rays(1001))


@pytest.mark.parametrize(("units", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_units_are_converted(units, metres):
    camera = Camera.from_dict(document(units=units))
    np.testing.assert_allclose(camera.position(), POSE[:3, 3] * metres)


@pytest.mark.parametrize(
    "distortion", [BROWN, {"model": "fisheye", "k": [0.05, -0.01, 0.003, -0.001]}, {"model": "none"}]
)
def test_rays_and_projection_agree(distortion):
    camera = Camera.from_dict(document(distortion=distortion))
    np.testing.assert_allclose(seen_pixels(camera), centres(camera), atol=2e-5)


def test_distortion_bends_the_rays():
    straight, bent = (Camera.from_dict(document(distortion=d)).rays(1001) for d in ({"model": "none"}, BROWN))
    local = bent @ POSE[:3, :3]
    assert np.abs(local[..., 2] - 1).max() < 1e-6  # still planar: camera z is 1
    assert np.linalg.norm(bent[0, 0] - straight[0, 0]) > 0.01


def test_frames_may_have_lenses_of_their_own():
    data = document(frames=("1001", "1002"))
    data["frames"]["1002"] |= {"fx": 60.0, "fy": 62.0, "distortion": BROWN}
    camera = Camera.from_dict(data)
    assert (camera.lens(1001).fx, camera.lens(1002).fx, camera.lens(1002).cx) == (30.0, 60.0, 16.2)
    assert not camera.lens(1001).distortion.acts
    for frame in (1001, 1002):
        np.testing.assert_allclose(seen_pixels(camera, frame), centres(camera), atol=2e-5)
    assert np.abs(camera.rays(1002) - camera.rays(1001)).max() > 0.1


def test_intrinsics_of_all_frames_need_no_default():
    data = document()
    data["frames"]["1001"]["fx"] = data.pop("fx")
    assert Camera.from_dict(data).fx == 30.0


def test_a_window_sees_the_same_world():
    whole = Camera.from_dict(document(distortion=BROWN))
    part = whole.windowed(5, -3, 20, 30)
    np.testing.assert_allclose(part.rays(1001)[3:27], whole.rays(1001)[:, 5:25], atol=1e-6)


def test_what_lies_outside_the_lens_has_no_pixel():
    """Far off the axis this polynomial would fold the point back into the picture."""
    camera = Camera.from_dict(document(distortion={"model": "brown", "k": [-0.3, 0, 0, 0]}))
    side = camera.position() + POSE[:3, :3] @ [1.8, 0, 1]
    assert np.isnan(camera.project(side)[:2]).all()


def test_a_lens_that_shows_nothing_in_a_corner_is_refused():
    camera = Camera.from_dict(document(distortion={"model": "brown", "k": [-2.0, 0, 0, 0]}))
    for use in (camera.rays, lambda: camera.check([1001])):
        with pytest.raises(JobError, match=r"The lens shows nothing in front of it at \d.* % of the pixels"):
            use()


SHEAR = np.array([[1, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
WRONG_POSES = {
    "it is column-major": POSE.T,
    "its last row is 0 0 0 5": np.vstack([POSE[:3], [0, 0, 0, 5]]),
    "it is scaled by 2": POSE * [2, 2, 2, 1],
    "it is left-handed": POSE * [-1, 1, 1, 1],
    "its axes are not orthonormal": POSE @ SHEAR,
}


@pytest.mark.parametrize("problem", WRONG_POSES)
def test_a_wrong_pose_is_refused_by_its_name(problem):
    with pytest.raises(JobError, match=problem):
        Camera.from_dict(document(WRONG_POSES[problem]))


@pytest.mark.parametrize(("changes", "message"), [
    ({"axes": "maya"}, "Unknown axes 'maya'"), ({"units": "feet"}, "Unknown units 'feet'"),
    ({"distorsion": BROWN}, "did you mean 'distortion'"), ({"fx": -30.0}, "`axes`"),
    ({"width": 31.5}, "whole positive"),
    ({"distortion": {"model": "brown", "k": [0.1]}}, "model 'brown' has 4 or 5 or 8 or 12"),
    ({"distortion": {"model": "brown", "k": [0.1] * 14}}, "tilted sensor"),
    ({"distortion": {"model": "none", "k": [0.1]}}, "model 'none' has 0"), ({"fy": True}, "fy is True"),
    ({"frames": {}}, "A camera pose cannot be read"),
    ({"frames": {"a": {"world_from_camera": [0] * 16}}}, "no frame number"),
])  # fmt: skip
def test_wrong_keys_are_refused(changes, message):
    with pytest.raises(JobError, match=message):
        Camera.from_dict(document(**changes))


def write_cameras(folder, **changes):
    one = {key: value for key, value in document(OPENGL).items() if key != "frames"}
    still = one | {"world_from_camera": OPENGL.ravel().tolist(), "gain": [1.1, 1, 0.9], "distortion": BROWN}
    cameras = {"c00": still, "c01": document(axes="opencv"), **changes}
    path = folder / "cameras.json"
    path.write_text(json.dumps({"axes": "opengl", "units": "cm", "cameras": cameras}))
    return path


def test_cameras_of_a_capture_are_read(tmp_path):
    first, second = read_cameras(write_cameras(tmp_path)).values()
    assert first.gain == (1.1, 1.0, 0.9)
    assert (first.pose_of(1001), second.pose_of(1001)) == (None, 1001)
    np.testing.assert_allclose(first.camera.pose(), second.camera.pose(1001))
    np.testing.assert_allclose(first.camera.position(), POSE[:3, 3] / 100)
    assert first.camera.lens().distortion.acts


@pytest.mark.parametrize(("entry", "message"), [
    ({"width": 3}, "not one of `world_from_camera` and `frames`"), (document() | {"gain": [1, 0, 1]}, "gain"),
    (document() | {"exposure": 1}, "camera bad.*did you mean|Unknown key 'exposure'"),
])  # fmt: skip
def test_a_wrong_camera_is_named(tmp_path, entry, message):
    with pytest.raises(JobError, match=message) as caught:
        read_cameras(write_cameras(tmp_path, bad=entry))
    assert "camera bad" in str(caught.value)
