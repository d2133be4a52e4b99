"""A job whose set is a scene of Blender: what is asked of Blender, what is delivered, what its keys depend on."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.blender_set.render import PaintedMesh, SceneFile, SetPictures, View, render_frame
from yesnt.core.errors import JobError, YesntError
from yesnt.io.jobfile import load_shot
from yesnt.io.pictures.image import read_image
from yesnt.planning.stages import BAKE, COMPOSITING, RELIGHT, SET
from yesnt.runtime.session import Session

FAKE = Path(__file__).with_name("fake_blender.py")


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Requests that the stand-in of Blender was given, a line each."""
    program = tmp_path / "blender"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{FAKE}" "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("YESNT_BLENDER", str(program))
    monkeypatch.setenv("FAKE_BLENDER_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


def write(folder: Path, **changes: Any) -> Path:
    job = write_tiny_shot(folder, 2, **{"light": "set", "set": {"blend": "room.blend", "at": [1, 2, 3]}, **changes})
    (folder / "room.blend").write_bytes(b"BLENDER")
    (folder / "wood.png").write_bytes(b"wood")
    return job


def asked(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text().splitlines()]


def delivered(session: Session, frame: int) -> dict[str, np.ndarray]:
    image = read_image(session.output.exr_path("tiny", frame))
    return {name: np.asarray(plane, np.float32) for name, plane in image.channels.items()}


def rgb(planes: dict[str, np.ndarray], layer: str = "") -> np.ndarray:
    return np.stack([planes[f"{layer}.{c}" if layer else c] for c in "RGB"], axis=-1)


def test_a_scene_and_a_shot_make_a_composite_lit_by_it(tmp_path: Path, log: Path) -> None:
    session = run_here(write(tmp_path / "shot", quality="draft"), "composite")
    what = [request["what"] for request in asked(log)]
    assert what == ["facts", "bake", "frame", "frame"]
    bake = asked(log)[1]
    frame = next(one for one in asked(log) if one["what"] == "frame" and one["frame"] == 1001)
    np.testing.assert_allclose(bake["place"], [1 + 0.015, 2, 3], atol=1e-3)  # the sphere moves by 0.03
    assert (frame["samples"], bake["samples"], frame["frame"]) == (16, 64, 1001)
    np.testing.assert_allclose(np.array(frame["camera"]["scene_from_camera"])[:3, 3], [1, 2 - 3, 3])
    planes = delivered(session, 1001)
    np.testing.assert_allclose(rgb(planes, "env")[-1, -1], [0.5, 0.4, 0.3], atol=1e-3)
    assert np.allclose(planes["shadow_set.Y"], 0.8, atol=2e-3)
    covered, held = planes["relit.A"] == 1, planes["holdout.Y"]
    assert (held[covered & (np.arange(40) < 18)] == 1).all()
    assert (held[:, 22:] == 0).all()
    hidden = rgb(planes)[covered & (held == 1)]
    np.testing.assert_allclose(hidden, np.broadcast_to([0.4, 0.32, 0.24], hidden.shape), atol=1e-3)
    total = rgb(planes, "front") + (1 - held[..., None]) * (
        rgb(planes, "relit")
        + (1 - planes["relit.A"][..., None])
        * (rgb(planes, "env") * planes["shadow_set.Y"][..., None] + rgb(planes, "reflection_set"))
    )
    np.testing.assert_allclose(total, rgb(planes), atol=2e-3)
    lit = rgb(planes, "relit")[covered]
    assert 0.02 < lit.mean() < 0.7  # a body under a uniform light of 0.7
    assert {p.name for p in session.output.exr.iterdir()} >= {"tiny.nk", "tiny_layers.py"}
    assert not any(session.output.blender.iterdir()), "what Blender rendered is not left behind"


def test_the_proxy_carries_the_materials_of_the_store(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    meshes: list[PaintedMesh] = []

    def spy(scene: SceneFile, view: View, mesh: PaintedMesh, *others: Any) -> SetPictures:
        meshes.append(mesh)
        return render_frame(scene, view, mesh, *others)

    monkeypatch.setattr("yesnt.tasks.scene.render_frame", spy)
    run_here(write(tmp_path / "shot", quality="draft"), "composite")
    found = meshes[0]
    # The stripes of the sphere, as the temporal solve leaves them: without materials all vertices would be alike.
    assert 0.3 < found.roughness.min() < found.roughness.max() - 0.1 < 0.7
    assert found.base_color.std(axis=0)[0] > 0.05


def test_a_run_that_was_cut_off_goes_on_with_the_same_bytes(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run_here(write(tmp_path / "whole", quality="draft"), "composite")
    job = write(tmp_path / "cut", quality="draft")
    monkeypatch.setenv("FAKE_BLENDER_DIES", "1")
    with pytest.raises(YesntError, match="Blender ended with status 7"):
        run_here(job, "composite")
    monkeypatch.delenv("FAKE_BLENDER_DIES")
    log.unlink()
    again = run_here(job, "composite")
    assert "bake" not in [request["what"] for request in asked(log)]
    for frame in (1001, 1002):
        left, right = (s.output.exr_path("tiny", frame).read_bytes() for s in (whole, again))
        assert left == right


def test_keys_depend_on_the_scene_its_files_its_place_and_blender(
    tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def keys(**changes: Any) -> dict[str, str]:
        graph = Session(write(tmp_path / "shot", **changes)).graph()
        return {node.stage.label: node.key for node in graph if node.frames[0] == 1001}

    first = keys()
    assert {"bake", "set", "composite.scripts"} <= set(first)
    moved = keys(set={"blend": "room.blend", "at": [1, 2, 4]})
    differs = {"bake", "relight", "set", "composite"}
    assert {stage for stage in first if moved[stage] != first[stage]} >= differs
    assert moved["solve"] == first["solve"]
    (tmp_path / "shot" / "wood.png").write_bytes(b"other wood")
    graph = Session(tmp_path / "shot" / "shot.yaml").graph()
    repainted = {node.stage.label: node.key for node in graph if node.frames[0] == 1001}
    assert all(repainted[stage] != moved[stage] for stage in differs)
    monkeypatch.setenv("FAKE_BLENDER_VERSION", "[4, 5, 3]")
    assert keys()["set"] != first["set"]
    ground = keys(set={"ground": -0.5}, light={"path": "light.exr"})
    assert ground["composite.scripts"] != first["composite.scripts"], "the parts of a scene in front are a layer"


def test_a_job_without_a_scene_has_none_of_its_stages(tmp_path: Path, log: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 2))
    assert not {BAKE, SET, COMPOSITING} & set(session.graph().stages)
    assert not log.exists(), "Blender is not asked"
    assert not {"set_open", "front"} & set(session.plan().arrays())
    assert RELIGHT in session.graph().stages


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"set": None}, r"`light: set` is baked from a scene; name it as `set: \{blend: scene.blend\}`"),
        ({"set": {"ground": "auto"}}, "`light: set` is baked from a scene"),
        ({"light": "sun"}, "it is a map .* or the word `set`"),
        ({"proxy": None}, "`set` needs `proxy`, which casts the shadow"),
        ({"set": {"blend": "room.obj"}}, "a scene is a file of .blend, .gltf, .glb"),
        ({"set": {"blend": "room.blend", "color": [1, 1, 1]}}, "`color` is of a ground or a mesh"),
        ({"set": {"ground": 0.0, "at": [1, 1, 1]}, "light": {"path": "light.exr"}}, "`at` is of `blend`"),
        ({"set": {"blend": "room.blend", "ground": 0.0}}, "it needs one of `ground`, `mesh` and `blend`"),
    ],
)
def test_sections_that_do_not_go_together_are_refused(tmp_path: Path, changes: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError, match=text):
        load_shot(write(tmp_path / "shot", **changes))


def test_a_lens_that_distorts_is_refused(tmp_path: Path, log: Path) -> None:
    job = write(tmp_path / "shot")
    camera = tmp_path / "shot" / "camera.json"
    document = json.loads(camera.read_text())
    camera.write_text(json.dumps({**document, "distortion": {"model": "brown", "k": [0.01, 0, 0, 0]}}))
    with pytest.raises(
        JobError, match=r"cannot be rendered through a lens that distorts.*undistort plate and G-buffer"
    ):
        Session(job)
