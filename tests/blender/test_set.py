"""The subject in a scene of Blender: what the camera sees, where it stands, what is baked, the same bytes each time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from yesnt.blender_set.place import ActorPlace
from yesnt.blender_set.render import PaintedMesh, SceneFile, SetPictures, View, bake_map, render_frame, scene_facts
from yesnt.blender_set.settings import DEPTH_FACTOR, BlenderSettings
from yesnt.capture_stage.cameras import look_at
from yesnt.capture_stage.tools import Tools, find_tools, run_script
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError, MissingPartError, YesntError
from yesnt.relight.envmap import row_solid_angles, uv_to_direction

pytestmark = [pytest.mark.blender, pytest.mark.timeout(1200)]

TINY = BlenderSettings(samples=4, map_rows=64, map_samples=64)
CAMERA = Camera(40, 32, 50.0, 40.0, 23.0, 12.0, {1001: look_at([0.4, -4.0, 1.6], [0.0, 0.0, 0.6])})
"""Oblong pixels and a principal point off the middle."""


@pytest.fixture(scope="module")
def tools() -> Tools:
    try:
        return find_tools(Path())
    except MissingPartError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory, tools: Tools) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    names = ["glossy_ground", "mirror_floor", "podium", "yard"]
    run_script(tools, Path(__file__).with_name("target_scenes.py"), [str(folder), *names], 300.0)
    run_script(tools, Path(__file__).with_name("odd_scenes.py"), [str(folder)], 300.0)
    return folder


def box(emission: float = 0.0) -> PaintedMesh:
    """A grey cube of half a metre that stands on the ground."""
    corners = np.array([[x, y, z] for x in (-0.25, 0.25) for y in (-0.25, 0.25) for z in (0, 0.5)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    grey, rough = np.full((8, 3), 0.5, np.float32), np.full(8, 0.6, np.float32)
    return PaintedMesh(corners, faces, grey, rough, np.zeros(8, np.float32), emission)


def rendered(scene: Path, tools: Tools, work: Path, mesh: PaintedMesh, place: ActorPlace | None = None) -> SetPictures:
    return render_frame(SceneFile(scene, place or ActorPlace()), View(CAMERA, 1001), mesh, TINY, tools, work)


def test_the_camera_never_sees_a_bright_proxy(scenes: Path, tools: Tools, tmp_path: Path) -> None:
    """In empty space a proxy that shines changes no pixel; over a floor it does, so that the test can fail."""
    empty = rendered(scenes / "empty.blend", tools, tmp_path / "empty", box(emission=50))
    assert np.array_equal(empty.present.radiance, empty.without.radiance)
    floor = rendered(scenes / "mirror_floor.blend", tools, tmp_path / "floor", box(emission=50))
    change = np.abs(floor.present.radiance - floor.without.radiance).max(axis=-1)
    assert change.max() > 5  # its reflection
    above = CAMERA.rays(1001)[..., 2] > 0  # the sky, before which it would stand
    assert above.any()
    assert change[above].max() < 0.2  # the denoiser's doing; the proxy itself would be 50


@pytest.mark.parametrize("place", [ActorPlace(), ActorPlace((3.0, -2.0, 0.0), 50.0)], ids=["origin", "moved"])
def test_depth_is_that_of_the_ground_through_the_shots_camera(
    scenes: Path, tools: Tools, tmp_path: Path, place: ActorPlace
) -> None:
    found = rendered(scenes / "mirror_floor.blend", tools, tmp_path, box(), place).depth
    n = DEPTH_FACTOR
    fine = replace(CAMERA, width=40 * n, height=32 * n, fx=50.0 * n, fy=40.0 * n, cx=23.0 * n, cy=12.0 * n)
    rays = fine.rays(1001).astype(np.float64)
    down = rays[..., 2] < -0.2
    expected = -CAMERA.position(1001)[2] / rays[down][:, 2]
    np.testing.assert_allclose(found[down], expected, rtol=2e-3)


def test_same_bytes_for_any_number_of_threads(scenes: Path, tools: Tools, tmp_path: Path) -> None:
    one = rendered(scenes / "yard.blend", tools, tmp_path / "one", box())
    two = rendered(scenes / "yard.blend", replace(tools, threads=2), tmp_path / "two", box())
    for left, right in ((one.without, two.without), (one.present, two.present)):
        assert np.array_equal(left.radiance, right.radiance)
        assert np.array_equal(left.glossy, right.glossy)
    assert np.array_equal(one.depth, two.depth)


def test_whole_pictures_are_kept_and_broken_ones_are_rendered_again(scenes: Path, tools: Tools, tmp_path: Path) -> None:
    first = rendered(scenes / "yard.blend", tools, tmp_path, box())
    times = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.exr")}
    (tmp_path / "with.exr").write_bytes((tmp_path / "with.exr").read_bytes()[:2000])
    again = rendered(scenes / "yard.blend", tools, tmp_path, box())
    assert np.array_equal(first.present.radiance, again.present.radiance)
    assert (tmp_path / "without.exr").stat().st_mtime_ns == times["without.exr"]


@pytest.mark.parametrize("yaw", [0.0, 90.0])
def test_the_baked_map_holds_the_lamps(scenes: Path, tools: Tools, tmp_path: Path, yaw: float) -> None:
    """Camera rays do not see lamps: without the ball about the camera, the map would be dark."""
    scene = SceneFile(scenes / "lamps.blend", ActorPlace(yaw=yaw))
    radiance = bake_map(scene, 1001, np.zeros(3), TINY, tools, tmp_path)
    rows, columns = radiance.shape[:2]
    weight = np.broadcast_to(row_solid_angles(rows, columns)[:, None], (rows, columns))
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    light = (radiance.mean(axis=-1) * weight)[..., None] * uv_to_direction(u, v)
    turn = ActorPlace(yaw=-yaw).scene_from_world[:3, :3]
    for aim, strength in (
        (np.array([0.0, -(0.5**0.5), 0.5**0.5]), 2.0),
        (np.array([0.0, 1.0, 0.0]), 100 / (36 * np.pi)),
    ):
        near = uv_to_direction(u, v) @ (turn @ aim) > 0.97
        arrived = light[near].sum(axis=0)
        assert np.linalg.norm(arrived) == pytest.approx(strength, rel=0.06)
        assert arrived @ (turn @ aim) / np.linalg.norm(arrived) > 0.999


def test_what_cannot_be_used_is_refused_by_name(scenes: Path, tools: Tools, tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"uses files that are not there: .*gone\.exr.*pack them into the file"):
        scene_facts(scenes / "lacking.blend", tools, tmp_path)
    with pytest.raises(JobError, match=r"unit scale is 0\.01.*one Blender unit to the metre"):
        scene_facts(scenes / "centimetres.blend", tools, tmp_path)
    with pytest.raises(YesntError, match="No light arrives at the actor's place"):
        bake_map(SceneFile(scenes / "empty.blend", ActorPlace()), 1001, np.zeros(3), TINY, tools, tmp_path)


def test_facts_name_the_files_that_a_scene_is_made_from(scenes: Path, tools: Tools, tmp_path: Path) -> None:
    found = scene_facts(scenes / "glossy_ground.blend", tools, tmp_path)
    assert [Path(path).name for path in found["files"]] == ["studio.exr"]
    assert found["working_space"] == "Linear Rec.709"


def test_a_gltf_scene_stands_under_the_jobs_light(scenes: Path, tools: Tools, tmp_path: Path) -> None:
    plain = SceneFile(scenes / "floor.glb", ActorPlace())
    dark = render_frame(plain, View(CAMERA, 1001), box(), TINY, tools, tmp_path / "dark")
    assert dark.without.radiance.max() == 0
    lit = replace(plain, world={"path": str(scenes / "maps" / "studio.exr"), "yaw": 0.0})
    found = render_frame(lit, View(CAMERA, 1001), box(), TINY, tools, tmp_path / "lit")
    assert found.without.radiance.min() > 0
    below = CAMERA.rays(1001)[..., 2] < -0.2
    assert found.depth[::DEPTH_FACTOR, ::DEPTH_FACTOR][below].max() < 1e3  # its floor lies in z = 0
    shadow = found.present.radiance[below].mean() / found.without.radiance[below].mean()
    assert shadow < 0.98


def test_a_script_that_raises_is_an_error(tools: Tools, tmp_path: Path) -> None:
    """A Blender program ends with status 0 after an error of a script unless it is asked not to."""
    script = tmp_path / "raises.py"
    script.write_text("raise ValueError('no')\n")
    with pytest.raises(YesntError, match="Blender ended with status 1"):
        run_script(tools, script, [], 120.0)
