import json

import numpy as np
import pytest

from tests.io.calibrations import rig as rigs
from yesnt.core.distortion import UNDISTORTED
from yesnt.core.errors import JobError
from yesnt.io.calibrations.document import by_camera
from yesnt.io.calibrations.registry import calibration_files
from yesnt.io.camera_files.files import read_cameras_of
from yesnt.io.camera_files.options import ImportOptions
from yesnt.io.cameras import World, read_cameras

FORMS = {
    "colmap text": (rigs.write_colmap_text, "model"), "colmap binary": (rigs.write_colmap_binary, "model"),
    "nerfstudio": (rigs.write_transforms, "transforms.json"), "qualisys": (rigs.write_qualisys, "calib.qca.txt"),
    "opencv files": (rigs.write_opencv_files, "calib"), "opencv pair": (rigs.write_opencv_pair, "calib"),
}  # fmt: skip
LENSES = {"none": UNDISTORTED, "brown": rigs.BROWN, "fisheye": rigs.FISHEYE}
CASES = [
    (form, lens) for form in FORMS for lens in LENSES
    if not (lens == "fisheye" and form in ("qualisys", "opencv pair"))
]  # fmt: skip


def written(tmp_path, form, lens="brown"):
    write, name = FORMS[form]
    cameras = rigs.rig(LENSES[lens])
    write(tmp_path / name, cameras)
    return tmp_path / name, cameras


@pytest.mark.parametrize(("form", "lens"), CASES)
def test_points_fall_on_the_same_pixels(tmp_path, form, lens) -> None:
    path, cameras = written(tmp_path, form, lens)
    found = read_cameras(path)
    assert list(found) == list(cameras)
    assert all(one.still for one in found.values())
    for name, expected in rigs.projections(cameras).items():
        camera = found[name].camera
        assert (camera.width, camera.height) == (cameras[name].width, cameras[name].height)
        assert np.allclose(camera.project(rigs.POINTS), expected, atol=1e-6), name


@pytest.mark.parametrize("form", FORMS)
def test_the_camera_verb_shows_any_calibration(tmp_path, form) -> None:
    path, cameras = written(tmp_path, form)
    assert list(read_cameras_of(path, ImportOptions())) == list(cameras)


@pytest.mark.parametrize(
    ("form", "count"), [("colmap text", 2), ("opencv files", 3), ("opencv pair", 2), ("qualisys", 1)]
)
def test_all_files_of_a_calibration_count(tmp_path, form, count) -> None:
    path, _ = written(tmp_path, form)
    assert len(calibration_files(path)) == count


def test_a_colmap_model_is_found_below_its_workspace(tmp_path) -> None:
    rigs.write_colmap_binary(tmp_path / "sparse/0", rigs.rig())
    assert list(read_cameras(tmp_path)) == ["cam1", "cam2", "cam3"]


def test_the_job_says_what_is_up_and_the_unit(tmp_path) -> None:
    path, cameras = written(tmp_path, "colmap text")
    turned = read_cameras(path, World("-y", "mm"))
    for name, one in turned.items():
        x, y, z = cameras[name].position()
        assert np.allclose(one.camera.position(), 0.001 * np.array([x, z, -y]))
        assert np.linalg.det(one.camera.pose()[:3, :3]) == pytest.approx(1)
    doubled = read_cameras(path, World(units=2.0))
    assert np.allclose(doubled["cam1"].camera.position(), 2 * cameras["cam1"].position())


def test_a_unit_of_the_job_replaces_that_of_the_format(tmp_path) -> None:
    path, cameras = written(tmp_path, "qualisys")
    assert np.allclose(read_cameras(path, World(units="mm"))["cam2"].camera.position(), cameras["cam2"].position())
    wrong = read_cameras(path, World(units="m"))["cam2"].camera.position()
    assert np.allclose(wrong, 1000 * cameras["cam2"].position())


def entry(x=0.0, **more):
    pose = np.eye(4)
    pose[0, 3] = x
    return {"width": 4, "height": 3, "fx": 5.0, "world_from_camera": pose.ravel().tolist(), **more}


def test_pictures_name_cameras() -> None:
    assert list(by_camera([("images/cam01.png", entry()), ("images/cam02.png", entry(1))], "f")) == ["cam01", "cam02"]
    rest = by_camera([("i/a/0001.png", entry()), ("i/a/0002.png", entry()), ("i/b/0001.png", entry(1))], "f")
    assert list(rest) == ["a", "b"]
    assert "frames" not in rest["a"]
    moving = by_camera([("a/f_0009.png", entry()), ("a/f_0010.png", entry(1)), ("b/f_0009.png", entry(2))], "f")
    assert list(moving["a"]["frames"]) == ["9", "10"]


def test_poses_of_one_camera_without_frame_numbers_are_refused() -> None:
    with pytest.raises(JobError, match="Camera a has several poses, and its pictures do not number the frames"):
        by_camera([("a/left.png", entry()), ("a/right.png", entry(1)), ("b/left.png", entry())], "f")


def test_a_single_file_of_nothing_known_is_refused(tmp_path) -> None:
    (tmp_path / "rig.toml").write_text("[cam1]\n")
    with pytest.raises(JobError, match=r"of no kind that is understood.*COLMAP.*OpenCV YAML"):
        read_cameras(tmp_path / "rig.toml")
    with pytest.raises(JobError, match=r"The calibration of the cameras is missing.*check the path"):
        read_cameras(tmp_path / "nowhere")


def test_a_camera_model_without_counterpart_is_refused(tmp_path) -> None:
    path, _ = written(tmp_path, "colmap text", "none")
    file = path / "cameras.txt"
    file.write_text(file.read_text().replace("1 PINHOLE 640 480", "1 FOV 640 480 0.9"))
    with pytest.raises(
        JobError, match=r"camera model FOV with 5 parameters cannot be used.*cameras.txt, line 2.*undistort"
    ):
        read_cameras(path)


def test_a_cut_binary_model_is_refused(tmp_path) -> None:
    path, _ = written(tmp_path, "colmap binary")
    file = path / "images.bin"
    file.write_bytes(file.read_bytes()[:90])
    with pytest.raises(JobError, match=r"The calibration cannot be read.*images.bin"):
        read_cameras(path)


def test_colmap_names_may_hold_blanks(tmp_path) -> None:
    path, _ = written(tmp_path, "colmap text")
    file = path / "images.txt"
    file.write_text(file.read_text().replace("cam1.png", "cam 1.png"))
    assert "cam 1" in read_cameras(path)


def test_transforms_without_a_size_say_so(tmp_path) -> None:
    matrix = np.eye(4).tolist()
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({"camera_angle_x": 0.7, "frames": [{"file_path": "r_0", "transform_matrix": matrix}]}))
    with pytest.raises(JobError, match=r"The frame lacks w, h\. Where: .*frames\[0\]"):
        read_cameras(path)


def test_a_mirroring_applied_transform_is_refused(tmp_path) -> None:
    path, _ = written(tmp_path, "nerfstudio")
    data = json.loads(path.read_text())
    data["applied_transform"][2][1] = 1
    path.write_text(json.dumps(data))
    with pytest.raises(JobError, match="`applied_transform` is no rotation and translation"):
        read_cameras(path)


def test_a_turned_view_of_qualisys_is_refused(tmp_path) -> None:
    path, _ = written(tmp_path, "qualisys")
    path.write_text(path.read_text().replace('viewrotation="0"', 'viewrotation="90"', 1))
    with pytest.raises(JobError, match=r"The camera's view is turned by 90 degrees.*camera cam1"):
        read_cameras(path)


def test_an_opencv_file_without_a_pose_is_refused(tmp_path) -> None:
    path, _ = written(tmp_path, "opencv files")
    file = path / "cam2.yml"
    file.write_text(file.read_text().replace("\nT:", "\nTT:"))
    with pytest.raises(JobError, match=r"The calibration lacks T\. Where: .*cam2.yml"):
        read_cameras(path)


def test_matrices_of_ros_are_read(tmp_path) -> None:
    path, cameras = written(tmp_path, "opencv files")
    for file in path.glob("*.yml"):
        plain = (
            file.read_text().replace(" !!opencv-matrix", "").replace("   dt: d\n", "").removeprefix("%YAML:1.0\n---\n")
        )
        file.write_text(plain)
    assert np.allclose(
        read_cameras(path)["cam3"].camera.project(rigs.POINTS), rigs.projections(cameras)["cam3"], atol=1e-6
    )
