"""Mistakes made on the shot that ships are reported before any work; the shot itself and its conversions raise none."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from tests.cases.shots import check, stored, write
from yesnt.core.camera import Camera
from yesnt.io.embedded_shot import SHOT
from yesnt.io.mesh import read_proxy
from yesnt.runtime.checks.consistency.contradictions import _mend
from yesnt.runtime.checks.preflight import resolve
from yesnt.runtime.session import Session
from yesnt.scene.ground import stance

FRAME = 1008
Planes = dict[str, np.ndarray]
NAMES = {"plate": f"plate.{FRAME}.exr", "gbuffer": f"gbuffer.{FRAME}.exr", "light": "env/sky.exr"}
AXES = np.array([1.0, -1.0, -1.0])


@cache
def planes_of(name: str) -> Planes:
    """Channels of an input of the embedded shot."""
    return stored(SHOT / name)


def write_frame(folder: Path, files: dict[str, Planes] | None = None, **job: Any) -> Path:
    """One frame of the embedded shot, with passes instead of a network, and with files replaced by role."""
    folder.mkdir()
    (folder / "env").mkdir()
    for name in (*NAMES.values(), "env/capture.exr", f"proxy.{FRAME}.ply", "camera.json"):
        shutil.copy(SHOT / name, folder / name)
    shutil.copy(SHOT / "truth" / f"material.{FRAME}.exr", folder)
    for role, planes in (files or {}).items():
        write(folder / NAMES[role], planes)
    document = yaml.safe_load((SHOT / "shot.yaml").read_text())
    document |= {"frames": str(FRAME), "decompose": {"path": "material.####.exr"}}
    del document["capture"], document["evidence"]
    for key, value in job.items():
        document[key] = document[key] | value if isinstance(value, dict) else value
    (folder / "shot.yaml").write_text(yaml.safe_dump(document))
    return folder


def normals(change: Callable[[np.ndarray], np.ndarray]) -> dict[str, Planes]:
    """The G-buffer with changed normals [H, W, 3]."""
    planes = planes_of(NAMES["gbuffer"])
    changed = change(np.stack([planes[f"N.{c}"] for c in "XYZ"], -1))
    return {"gbuffer": planes | {f"N.{c}": changed[..., i].astype(np.float32) for i, c in enumerate("XYZ")}}


def depth(change: Callable[[np.ndarray], np.ndarray]) -> dict[str, Planes]:
    """The G-buffer with changed z [H, W] where something was hit."""
    planes = planes_of(NAMES["gbuffer"])
    z = planes["depth.Z"]
    return {"gbuffer": planes | {"depth.Z": np.where(z < 1e9, change(z), z if change(z).min() > 0.9 else 0)}}


def plate(factor: float = 1.0, alpha: float = 1.0) -> dict[str, Planes]:
    """The plate with changed colours or alpha."""
    planes = planes_of(NAMES["plate"])
    return {"plate": {name: plane * (alpha if name == "A" else factor) for name, plane in planes.items()}}


CAMERA = Camera.open(SHOT / "camera.json")
ROTATION = CAMERA.pose(FRAME)[:3, :3]
SLANT = np.linalg.norm(CAMERA.rays(FRAME), axis=-1)
LIGHT = {name: plane[:, : plane.shape[1] // 2].copy() for name, plane in planes_of(NAMES["light"]).items()}

PICTURES: dict[str, tuple[dict[str, Planes], str]] = {
    "normals flipped": (normals(lambda n: -n), "0% of the normals face the camera .*flipped"),
    "normals in 0 to 1": (normals(lambda n: n / 2 + 0.5), "would be .* if the job said `normal_range: unsigned`"),
    "normals of the camera": (normals(lambda n: n @ ROTATION), "if the job said `normal_space: camera`$"),
    "normals of OpenGL's camera": (normals(lambda n: n @ ROTATION * AXES), "job said `normal_space: camera_opengl`"),
    "normals in 0 to 1 of OpenGL's camera": (
        normals(lambda n: n @ ROTATION * AXES / 2 + 0.5), "`normal_range: unsigned` and `normal_space: camera_opengl`",
    ),
    "normals of a Y-up world": (normals(lambda n: n[..., [0, 2, 1]] * [1, 1, -1]), "said `normal_space: world_y_up`"),
    "distance along the ray": (depth(lambda z: z * SLANT), r"distance along the ray \(10\d%.*say `z_kind: ray`"),
    "depth in 0 to 1": (depth(lambda z: (z - 2) / 2), r"depth changes 3\.\d+ times as much .*depth from 0 to 1"),
    "depth from a plane behind the camera": (depth(lambda z: z + 3), r"depth changes 0\.5\d* times as much"),
    "inverse depth": (depth(lambda z: 1 / z), r"depth grows where .* it falls at \d+%.*`z_kind: inverse`"),
    "depth in millimetres": (depth(lambda z: z * 1000), r"subject is \d+ m large"),
    "depth in centimetres": (depth(lambda z: z * 100), r"would be 100% if the job said `units: cm` of the G"),
    "a plate three stops too bright": (plate(8.0), r"\d\d% of the covered pixels are brighter than a white surface"),
    "a plate four stops too dark": (plate(1 / 16), "99 % of the covered pixels would reflect less than 0.049 "),
    "alpha in 0 to 255": (plate(1.0, 255), r"Alpha goes up to 255\."),
    "an empty matte": (plate(0.0, 0.0), "frames whose matte is empty: 1"),
    "a square light map": ({"light": LIGHT}, r"is \d+x\d+, 1 to 1, and a lat-long map is 2 to 1"),
}  # fmt: skip


def reported(folder: Path) -> str:
    """Everything that the checks say."""
    outcome = check(folder)
    return "\n".join((outcome.refusal, *outcome.warnings)).strip()


def test_the_embedded_shot_raises_no_warning(tmp_path: Path) -> None:
    assert reported(write_frame(tmp_path / "s")) == ""


@pytest.mark.parametrize("mistake", PICTURES)
def test_a_wrong_picture_is_reported(tmp_path: Path, mistake: str) -> None:
    files, message = PICTURES[mistake]
    assert re.search(message, reported(write_frame(tmp_path / "s", files)))


CONVERTED: dict[str, tuple[dict[str, Planes], dict[str, str]]] = {
    "distance along the ray": (depth(lambda z: z * SLANT), {"z_kind": "ray"}),
    "inverse depth": (depth(lambda z: 1 / z), {"z_kind": "inverse"}),
    "inverse depth in centimetres": (depth(lambda z: 0.01 / z), {"z_kind": "inverse", "units": "cm"}),
    "millimetres": (depth(lambda z: z * 1000), {"units": "mm"}),
    "normals of the camera": (normals(lambda n: n @ ROTATION), {"normal_space": "camera"}),
    "normals of OpenGL's camera": (normals(lambda n: n @ ROTATION * AXES), {"normal_space": "camera_opengl"}),
    "normals of a Y-up world": (normals(lambda n: n[..., [0, 2, 1]] * [1, 1, -1]), {"normal_space": "world_y_up"}),
    "normals in 0 to 1": (normals(lambda n: n / 2 + 0.5), {"normal_range": "unsigned"}),
}


@pytest.mark.parametrize("kind", CONVERTED)
def test_what_the_job_states_is_converted(tmp_path: Path, kind: str) -> None:
    files, gbuffer = CONVERTED[kind]
    assert reported(write_frame(tmp_path / "s", files, gbuffer=gbuffer)) == ""


@pytest.mark.parametrize(
    ("gbuffer", "message"),
    [
        ({"z_kind": "ray"}, "depth is planar and not distance"),
        ({"normal_space": "camera"}, "said `normal_space: world`"),
    ],
)
def test_a_wrong_statement_is_reported(tmp_path: Path, gbuffer: dict[str, str], message: str) -> None:
    assert message in reported(write_frame(tmp_path / "s", gbuffer=gbuffer))


def write_proxy(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    mesh = trimesh.load(folder / f"proxy.{FRAME}.ply", process=False)
    mesh.vertices = change(np.asarray(mesh.vertices))
    mesh.export(folder / f"proxy.{FRAME}.ply")


def test_proxies_in_other_units_and_axes_are_converted(tmp_path: Path) -> None:
    plain = write_frame(tmp_path / "plain")
    folder = write_frame(tmp_path / "s", proxy={"units": "mm", "up": "y"})
    write_proxy(folder, lambda v: v[:, [0, 2, 1]] * [1000, 1000, -1000])
    assert reported(folder) == ""
    job, same = resolve(folder).job, resolve(plain).job
    np.testing.assert_allclose(read_proxy(job, FRAME).vertices, read_proxy(same, FRAME).vertices, atol=1e-5)


def test_what_a_proxy_is_said_to_be_enters_the_keys_of_relighting(tmp_path: Path) -> None:
    keys = []
    for name, said in (("a", {}), ("b", {"units": "m", "up": "z"}), ("c", {"units": "cm"})):
        graph = Session(write_frame(tmp_path / name, proxy=said)).graph()
        keys.append({node.stage.name: node.key for node in graph if node.stage.name in ("decompose", "relight")})
    assert keys[0] == keys[1]
    assert keys[0]["decompose"] == keys[2]["decompose"]
    assert keys[0]["relight"] != keys[2]["relight"]


def write_camera(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    document = json.loads((folder / "camera.json").read_text())
    pose = change(np.reshape(document["frames"][str(FRAME)]["world_from_camera"], (4, 4)))
    document["frames"] = {str(FRAME): {"world_from_camera": np.ravel(pose).tolist()}}
    (folder / "camera.json").write_text(json.dumps(document))


@pytest.mark.parametrize(("change", "message"), [
    (lambda pose: pose * [1, -1, -1, 1], 'if camera.json said `"axes": "opengl"`'),
    (lambda pose: pose.T, "column-major"), (lambda pose: pose * [-1, 1, 1, 1], "left-handed"),
    (lambda pose: np.linalg.inv(pose), "of the normals face the camera|proxy lies where"),
])  # fmt: skip
def test_a_wrong_camera_is_reported(tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], message: str) -> None:
    folder = write_frame(tmp_path / "s")
    write_camera(folder, change)
    assert re.search(message, reported(folder))


@pytest.mark.parametrize(("change", "message"), [
    (lambda v: np.add(v, [0.5, 0, 0]), r"proxy lies where depth says at \d+%"),
    (lambda v: v / 100, "if the proxy were 100 times as large"),
    (lambda v: v * 100, "would be .* if the job said `units: cm` of the proxy"),
    (lambda v: v[:, [0, 2, 1]] * [1, 1, -1], "if the job said `up: y` of the proxy"),
    (lambda v: v * [0, 0, 1], "100 % of the proxy's triangles have no area"),
])  # fmt: skip
def test_a_wrong_proxy_is_reported(tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], message: str) -> None:
    folder = write_frame(tmp_path / "s")
    write_proxy(folder, change)
    assert re.search(message, reported(folder))


@pytest.mark.parametrize(
    ("ground", "message"),
    [
        (0.0, None),
        (0.25, "stands inside the ground; `ground: FEET` or `ground: auto` puts the ground under them"),
        (-0.3, "it floats, unless it is in the air there; `ground: FEET` or `ground: auto` puts"),
    ],
)
def test_a_ground_that_the_feet_contradict_is_reported(tmp_path: Path, ground: float, message: str | None) -> None:
    """The height is counted from the feet."""
    mesh = trimesh.load_mesh(SHOT / f"proxy.{FRAME}.ply", process=False)
    feet = stance(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)).contact
    found = reported(write_frame(tmp_path / "shot", set={"ground": feet + ground}))
    if message is None:
        assert "feet" not in found
        return
    side = "below" if ground > 0 else "above"
    assert f"set and proxy: the feet of the subject are {abs(ground):.3g} m {side} `ground:" in found
    assert message.replace("FEET", f"{feet:.3g}") in found


def test_mistakes_that_fit_alike_are_all_named() -> None:
    mends = [{"the job said A": (1.0, 0.02), "the job said B": (1.0, 0.02), "they were flipped": (0.9, 0.3)}]
    assert _mend(mends, 0.8, "look at it") == "it would be 100% if the job said A, or if the job said B"
    assert _mend(mends, 1.1, "look at it") == "look at it"
