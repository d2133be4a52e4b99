"""Cameras of Nuke, USD, Alembic and Blender, and what `yesnt camera` says of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from yesnt.cli.app import app
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError, MissingPartError, UsageError, YesntError
from yesnt.io.camera_files.files import read_cameras_of
from yesnt.io.camera_files.inside_blender.export_camera import frames_of, lens_of
from yesnt.io.camera_files.options import ImportOptions

SIZE = (640, 360)
LINE = (1.0, 2.0, 5.0, -10.0, 20.0, 5.0)
Y_UP_POINT = np.array([0.5, 1.0, -1.0])


def read(path: Path, **options: object) -> Camera:
    (camera,) = read_cameras_of(path, ImportOptions(size=SIZE, **options)).values()  # type: ignore[arg-type]
    return camera


def write_chan(folder: Path, *columns: float, frames: tuple[int, ...] = (1001, 1002)) -> Path:
    path = folder / "cam.chan"
    path.write_text("# comment\n" + "".join(f"{f}\t{' '.join(map(str, columns))}\n" for f in frames))
    return path


def nuke_pixel(point: np.ndarray, fx: float, fy: float) -> np.ndarray:
    """Where Nuke's camera of LINE shows a point of its Y-up world: rotations about z, then x, then y."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(LINE[3:])), np.sin(np.radians(LINE[3:]))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    x, y, z = (about_y @ about_x @ about_z).T @ (point - LINE[:3])
    return np.array([SIZE[0] / 2 + fx * x / -z, SIZE[1] / 2 - fy * y / -z])


def z_up(point: np.ndarray) -> np.ndarray:
    return np.array([point[0], -point[2], point[1]])


def test_chan_shows_what_nuke_shows(tmp_path: Path) -> None:
    camera = read(write_chan(tmp_path, *LINE, 30.0))
    focal = SIZE[1] / 2 / np.tan(np.radians(15))
    assert (camera.fx, camera.fy) == pytest.approx((focal, focal))
    assert sorted(camera.poses) == [1001, 1002]
    np.testing.assert_allclose(camera.project(z_up(Y_UP_POINT), 1001)[:2], nuke_pixel(Y_UP_POINT, focal, focal))
    np.testing.assert_allclose(read(write_chan(tmp_path, *LINE, 30.0), up="z").position(1001), LINE[:3])


@pytest.mark.parametrize(("options", "fx", "fy"), [
    ({"focal": 50.0, "aperture": (25.0, None)}, 1280, 1280),
    ({"focal": 50.0, "aperture": (25.0, None), "pixel_aspect": 2.0}, 1280, 2560),
    ({"focal": 50.0, "aperture": (25.0, 20.0)}, 1280, 900),
    ({"aperture": (24.0, 18.0)}, 240 / np.tan(np.radians(15)), 240 / np.tan(np.radians(15))),
    ({"pixel_aspect": 2.0}, 90 / np.tan(np.radians(15)), 180 / np.tan(np.radians(15))),
])  # fmt: skip
def test_sensors_become_pixels(tmp_path: Path, options: dict[str, object], fx: float, fy: float) -> None:
    camera = read(write_chan(tmp_path, *LINE, 30.0), **options)
    assert (camera.fx, camera.fy) == pytest.approx((fx, fy))


@pytest.mark.parametrize(("text", "options", "message"), [
    ("1001 0 0 0 0 0 0\n", {}, "no field of view.*--focal"), ("1001 0 0 0 0 0\n", {}, "cam.chan, line 1"),
    ("1001 0 0 0 0 0 x 30\n", {}, "no frame of a camera"), ("", {}, "The file has no frames"),
    ("1001 0 0 0 0 0 0 30\n", {"aperture": (24.0, None)}, "--aperture 24.576x18.672"),
    ("1001 0 0 0 0 0 0 30\n", {"frames": (1001, 1007)}, "no frame 1007"),
    ("1001 0 0 0 0 0 0 30\n", {"rotation_order": "XYX"}, "--rotation-order 'XYX' is unknown"),
    ("1001 0 0 0 0 0 0 30\n", {"up": "x"}, "--up 'x' is unknown"),
    ("1001 0 0 0 0 0 0 30\n", {"size": None}, "size of the pictures is not in this file"),
])  # fmt: skip
def test_a_chan_that_leaves_something_open_is_refused(
    tmp_path: Path, text: str, options: dict[str, object], message: str
) -> None:
    (tmp_path / "cam.chan").write_text(text)
    with pytest.raises((JobError, UsageError), match=message):
        read_cameras_of(tmp_path / "cam.chan", ImportOptions(**({"size": SIZE} | options)))  # type: ignore[arg-type]


USD = """#usda 1.0
( endTimeCode = 1002\n startTimeCode = 1001\n metersPerUnit = 0.01\n upAxis = "Y" )
def Xform "rig" {{
    double3 xformOp:scale = (3, 3, 3)
    uniform token[] xformOpOrder = ["xformOp:scale"]
    def Camera "main" {{
        float focalLength.timeSamples = {{ 1001: 40, 1002: 50 }}
        float horizontalAperture = 36\n float verticalAperture = 20.25
        float horizontalApertureOffset = 1.8\n float verticalApertureOffset = -3.6
        double3 xformOp:translate = (100, 200, 500)
        float3 xformOp:rotateXYZ = (10, 20, 30)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }}
}}
{more}
"""


def test_usd_shows_what_its_own_frustum_shows(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import Gf, UsdGeom

    path = tmp_path / "cam.usda"
    path.write_text(USD.format(more=""))
    camera = read(path)
    stage = usd.Stage.Open(str(path))
    for frame in (1001, 1002):
        frustum = UsdGeom.Camera(stage.GetPrimAtPath("/rig/main")).GetCamera(frame).frustum
        point = Gf.Vec3d(320, 650, 1000)
        seen = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(point)
        expected = (seen[0] + 1) / 2 * SIZE[0], (1 - seen[1]) / 2 * SIZE[1]
        np.testing.assert_allclose(camera.project(z_up(np.array(point) / 100), frame)[:2], expected, rtol=1e-5)


def test_a_usd_file_of_several_cameras_needs_a_name(tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd")
    path = tmp_path / "cam.usda"
    path.write_text(USD.format(more='def Camera "other" {}'))
    with pytest.raises(JobError, match=r"The file has 2 cameras. Where: .*/rig/main, /other.*--camera PATH"):
        read(path)
    assert read(path, camera="main").fx == pytest.approx(40 / 36 * 640)
    path.write_text("nonsense")
    with pytest.raises(JobError, match="The USD file cannot be opened"):
        read(path)


def test_absent_libraries_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MissingPartError, match=r"usd-core.*pip install 'yesnt\[usd\]'"):
        read(tmp_path / "cam.usd")
    monkeypatch.setenv("YESNT_BLENDER", "/nowhere/blender")
    (tmp_path / "cam.abc").touch()
    with pytest.raises(MissingPartError, match="Blender is not here"):
        read(tmp_path / "cam.abc")
    with pytest.raises(JobError, match=r"of the kind .fbx is not understood.*--blender-script"):
        read(tmp_path / "cam.fbx")


def blender_camera(fit: str = "AUTO", **changes: object) -> SimpleNamespace:
    known = {"type": "PERSP", "lens": 50.0, "sensor_width": 36.0, "sensor_height": 24.0, "shift_x": 0.0, "shift_y": 0.0}
    return SimpleNamespace(**known | changes, sensor_fit=fit)


def blender_render(width: int, height: int, aspect: tuple[float, float] = (1, 1), **changes: object) -> SimpleNamespace:
    known = {"use_border": False, "use_crop_to_border": False, "resolution_percentage": 100}
    aspects = {"pixel_aspect_x": aspect[0], "pixel_aspect_y": aspect[1]}
    return SimpleNamespace(resolution_x=width, resolution_y=height, **aspects, **known | changes)


@pytest.mark.parametrize(("fit", "size", "aspect", "fx", "fy"), [
    ("AUTO", (360, 200), (1, 1), 500, 500), ("AUTO", (200, 360), (1, 1), 500, 500),
    ("HORIZONTAL", (180, 360), (1, 1), 250, 250), ("VERTICAL", (360, 240), (1, 1), 500, 500),
    ("AUTO", (360, 200), (2, 1), 500, 1000), ("AUTO", (360, 300), (1, 2), 500 / 0.6, 500 / 1.2),
])  # fmt: skip
def test_the_lens_of_blender(
    fit: str, size: tuple[int, int], aspect: tuple[float, float], fx: float, fy: float
) -> None:
    found = lens_of(blender_camera(fit), blender_render(*size, aspect))
    assert (found["fx"], found["fy"]) == pytest.approx((fx, fy))
    assert (found["cx"], found["cy"]) == (size[0] / 2, size[1] / 2)


def test_what_the_script_for_blender_cannot_say_is_refused() -> None:
    moved = lens_of(blender_camera(shift_x=0.1, shift_y=0.2), blender_render(100, 50))
    assert (moved["cx"], moved["cy"]) == pytest.approx((40, 45))
    with pytest.raises(SystemExit, match="PANO; expected a perspective camera"):
        lens_of(blender_camera(type="PANO"), blender_render(100, 50))
    with pytest.raises(SystemExit, match="Crop to Render Region"):
        lens_of(blender_camera(), blender_render(100, 50, use_border=True, use_crop_to_border=True))
    assert frames_of("1001-1003,1007", None) == [1001, 1002, 1003, 1007]
    assert frames_of("", SimpleNamespace(frame_start=1, frame_end=5, frame_step=2)) == [1, 3, 5]


SCENE = """
import sys
import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
bpy.ops.wm.read_factory_settings(use_empty=True)
scene, lens = bpy.context.scene, bpy.data.cameras.new("lens")
scene.camera = bpy.data.objects.new("cam", lens)
scene.collection.objects.link(scene.camera)
scene.render.resolution_x, scene.render.resolution_y, scene.render.pixel_aspect_x = 640, 360, ASPECT
scene.camera.rotation_euler, lens.lens, lens.shift_x, lens.shift_y = (1.3, 0.1, 0.2), 40, 0.05, -0.1
actor = bpy.data.collections.new("Actor")
scene.collection.children.link(actor)
bpy.ops.mesh.primitive_cube_add(location=(0, 0, 1))
bpy.context.object.users_collection[0].objects.unlink(cube := bpy.context.object)
actor.objects.link(cube)
for frame in (1001, 1003):
    scene.camera.location = (frame - 1000, -5, 2)
    scene.camera.keyframe_insert("location", frame=frame)
scene.frame_start, scene.frame_end = 1001, 1003
out = sys.argv[-1]
bpy.ops.wm.alembic_export(filepath=out + "/cam.abc", start=1001, end=1003)
bpy.ops.wm.usd_export(filepath=out + "/cam.usda", export_animation=True)
names = {"__name__": "export"}
exec(compile(open(out + "/export.py").read(), "export.py", "exec"), names)
names["main"](["--out", out, "--proxy", "Actor"])
scene.frame_set(1003)
seen = world_to_camera_view(scene, scene.camera, Vector((0.5, 1, 0.5)))
print("SEEN", seen.x * 640, (1 - seen.y) * 360)
"""


@pytest.mark.blender
def test_blender_alembic_and_usd_show_what_blender_shows(tmp_path: Path) -> None:
    from yesnt.io.mesh import read_mesh

    assert "camera" in typer.main.get_command(app).commands
    script = CliRunner().invoke(app, ["camera", "--blender-script"]).stdout
    (tmp_path / "export.py").write_text(script)
    (tmp_path / "scene.py").write_text(SCENE.replace("ASPECT", "1"))
    blender = os.environ.get("YESNT_BLENDER", ".venv-blender/bin/python")
    done = subprocess.run([blender, tmp_path / "scene.py", tmp_path], capture_output=True, text=True, check=True)
    seen = [float(v) for v in next(line for line in done.stdout.splitlines() if line.startswith("SEEN")).split()[1:]]
    for camera in (Camera.open(tmp_path / "camera.json"), read(tmp_path / "cam.abc"), read(tmp_path / "cam.usda")):
        np.testing.assert_allclose(camera.project(np.array([0.5, 1, 0.5]), 1003)[:2], seen, atol=2e-3)
    mesh = read_mesh(tmp_path / "proxy.1002.ply")
    assert (mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist()) == ([-1, -1, 0], [1, 1, 2])
    (tmp_path / "broken.abc").write_text("nonsense")
    with pytest.raises(JobError, match="The Alembic file cannot be read"):
        read(tmp_path / "broken.abc")


def invoked(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["camera", *map(str, arguments)], standalone_mode=False)
    if result.exception:
        raise result.exception
    return result.stdout


def test_the_command_says_what_a_camera_means_and_writes_it(tmp_path: Path) -> None:
    chan, out = write_chan(tmp_path, *LINE, 30.0), tmp_path / "camera.json"
    said = invoked(chan, "--size", "640x360", "--write", out)
    for line in ("pictures         640x360", "frames           1001-1002 (2)",
                 "field of view    50.94 degrees across, 30 down",
                 "distortion       none", "first frame      at (1.000, -5.000, 2.000) m", f"Wrote {out}"):  # fmt: skip
        assert line in said
    again = Camera.open(out)
    np.testing.assert_allclose(again.rays(1001), read(chan).rays(1001), atol=1e-6)
    document = json.loads(invoked(out, "--json"))["camera"]
    assert document["fx"] == pytest.approx(again.fx)
    assert document["warnings"] == []


def test_odd_cameras_are_warned_about(tmp_path: Path) -> None:
    pose = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]  # Y up, in a Z-up world
    document = {"width": 64, "height": 48, "fx": 2000.0, "fy": 1000.0, "cx": 8.0, "cy": 24.0}
    frames = {
        "1": {"world_from_camera": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]},
        "2": {"world_from_camera": pose},
    }
    tilted = {"3": {"world_from_camera": [0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0, 1]}}
    lens = {"distortion": {"model": "brown", "k": [-0.1, 0, 0, 0]}}
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(document | lens | {"frames": frames | tilted}))
    said = invoked(path)
    for text in ("principal point lies 38% of the picture beside its middle", "fy is 0.5 times fx",
                 "the field of view is 1.83 degrees", "up is not the world's at 33% of the frames, first 3",
                 "distortion       brown [-0.1, 0.0, 0.0, 0.0]"):  # fmt: skip
        assert text in said


@pytest.mark.parametrize(("arguments", "message"), [
    ((), "No camera is named"), (("x.chan", "--size", "640"), "--size '640' cannot be used"),
    (("x.chan", "--size", "axb"), "--size 'axb' cannot be used"), (("x.json",), "The camera file is missing"),
])  # fmt: skip
def test_wrong_options_are_refused(arguments: tuple[str, ...], message: str) -> None:
    with pytest.raises(YesntError, match=message):
        invoked(*arguments)


def test_cameras_of_a_capture_are_described_by_name(tmp_path: Path) -> None:
    one = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0}
    still = one | {"world_from_camera": [1, 0, 0, 0, 0, 0, 1, -3, 0, -1, 0, 0, 0, 0, 0, 1]}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": {"c00": still, "c01": still}}))
    assert list(json.loads(invoked(path, "--json"))) == ["c00", "c01"]
    assert list(json.loads(invoked(path, "--json", "--camera", "c01"))) == ["c01"]
    with pytest.raises(JobError, match="no camera 'c07'"):
        invoked(path, "--camera", "c07")
    with pytest.raises(UsageError, match="The file has 2 cameras"):
        invoked(path, "--write", tmp_path / "camera.json")
