"""The set through a job file: what is delivered, what it depends on, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.in_process import run_here, shard_digests
from tests.relight.scenes import box_mesh
from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import CorruptError, JobError
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import load_shot
from yesnt.io.pictures.image import read_image
from yesnt.planning.stages import GROUND, RELIGHT, SET
from yesnt.runtime.session import Session
from yesnt.tasks.ground import read_ground
from yesnt.tasks.workspace import Workspace

LAYERS = {"shadow_set.Y", "holdout.Y", *(f"{name}.{c}" for name in ("reflection_set", "env") for c in "RGB")}


def delivered(path: Path, frame: int = 1001) -> dict[str, np.ndarray]:
    """Planes of a delivered frame."""
    session = run_here(path, "composite")
    image = read_image(session.output.exr_path("tiny", frame))
    return {name: np.asarray(plane, np.float32) for name, plane in image.channels.items()}


def rgb(planes: dict[str, np.ndarray], layer: str = "") -> np.ndarray:
    return np.stack([planes[f"{layer}.{c}" if layer else c] for c in "RGB"], axis=-1)


def reassembled(planes: dict[str, np.ndarray]) -> np.ndarray:
    """The composite from its layers, as docs/set.md says."""
    shown = 1 - planes["holdout.Y"][..., None]
    alpha = planes["relit.A"][..., None] * shown
    behind = rgb(planes, "env") * planes["shadow_set.Y"][..., None] + rgb(planes, "reflection_set")
    return rgb(planes, "relit") * shown + (1 - alpha) * behind


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_shot(tmp_path_factory.mktemp("set") / "shot", 2, set={"ground": "auto"})


def test_the_layers_make_the_composite(shown: Path) -> None:
    planes = delivered(shown)
    assert set(planes) >= LAYERS
    assert np.abs(reassembled(planes) - rgb(planes)).max() < 2e-3 * rgb(planes).max()
    shadow = planes["shadow_set.Y"]
    assert shadow.min() < 0.9
    assert shadow.max() == 1
    assert not planes["holdout.Y"].any()


def test_the_ground_lies_under_the_subject_in_every_frame(shown: Path) -> None:
    session = run_here(shown, "composite")
    held = json.loads(session.output.ground.read_text())
    assert held["height"] == pytest.approx(-0.5, abs=0.01), "the sphere's lowest point"
    record = session.book.find(GROUND, 1001)
    assert record is not None
    assert record.facts["ground"] == held["height"]
    assert len([n for n in session.graph() if n.stage == GROUND]) == 1


def test_the_same_bytes_in_any_order(shown: Path, tmp_path: Path) -> None:
    names = "set_open", "set_ratio", "set_added", "base_color", "diffuse"
    once = shard_digests(run_here(shown, "composite"), *names)
    again = run_here(write_tiny_shot(tmp_path / "shot", 2, set={"ground": "auto"}), "composite", order=3)
    assert once
    assert shard_digests(again, *names) == once


def test_a_damaged_ground_is_named_and_made_again(tmp_path: Path) -> None:
    session = run_here(write_tiny_shot(tmp_path / "shot", 1, set={"ground": "auto"}), "ground")
    good = session.output.ground.read_text()
    session.output.ground.write_text("{}")
    node = session.graph().committer(RELIGHT, 1001)
    with pytest.raises(CorruptError, match="The ground under the subject is not what was committed"):
        read_ground(Workspace(session.job, node))
    run_here(tmp_path / "shot", "ground")
    assert session.output.ground.read_text() == good


def test_without_a_set_nothing_of_it_is_there(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 1)
    planes = delivered(path)
    assert not LAYERS & set(planes)
    session = Session(path)
    assert {SET, GROUND}.isdisjoint(session.graph().stages)
    assert not {"set_open", "set_ratio", "set_added", "holdout"} & set(session.plan().arrays())


def test_catch_changes_a_plate_only_by_shadow_and_reflection(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 1, set={"ground": -0.5, "mode": "catch"}, background={"path": "bg.exr"})
    rng = np.random.default_rng(1)
    plate = rng.uniform(0.1, 1, (32, 40, 3)).astype(np.float32)
    write_exr(path.parent / "bg.exr", {c: plate[..., i] for i, c in enumerate("RGB")})
    planes = delivered(path)
    np.testing.assert_allclose(rgb(planes, "env"), plate, rtol=1e-3)
    sky = slice(0, 14)  # above the horizon, beside the sphere
    np.testing.assert_array_equal(planes["shadow_set.Y"][sky], 1)
    assert not rgb(planes, "reflection_set")[sky].any()
    assert planes["shadow_set.Y"].min() < 0.9
    assert np.abs(reassembled(planes) - rgb(planes)).max() < 2e-3


def test_a_wall_before_the_subject_holds_it_out(tmp_path: Path) -> None:
    vertices, faces = box_mesh((-0.9, -1.0, -0.6), (0.0, -0.9, 0.6))
    path = write_tiny_shot(tmp_path / "shot", 1, set={"mesh": "wall.ply"})
    write_mesh(path.parent / "wall.ply", vertices, faces)
    planes = delivered(path)
    covered = planes["relit.A"] > 0
    left = covered & (np.arange(40) < 14)
    right = covered & (np.arange(40) > 26)
    assert left.any()
    assert right.any()
    np.testing.assert_array_equal(planes["holdout.Y"][left], 1)
    np.testing.assert_array_equal(planes["holdout.Y"][right], 0)
    assert np.abs(reassembled(planes) - rgb(planes)).max() < 2e-3 * rgb(planes).max()


def write_mesh(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    import trimesh

    trimesh.Trimesh(vertices, faces, process=False).export(path)


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({"set": {}}, "it needs one of `ground`, `mesh` and `blend`"),
        ({"set": {"ground": 0.0, "mesh": "a.ply"}}, "it needs one of `ground`, `mesh` and `blend`"),
        ({"set": {"mesh": "a.ply", "radius": 3.0}}, "`radius` is of a ground, a mesh has its own size"),
        ({"set": {"ground": "auto"}, "proxy": None}, "`set` needs `proxy`, which casts the shadow"),
        (
            {"set": {"ground": "auto", "mode": "catch"}},
            "`set.mode: catch` needs `background`, which receives the shadow",
        ),
        ({"set": {"ground": "auto"}, "background": {"path": "bg.exr"}}, "remove `background`, or set mode: catch"),
        ({"set": {"ground": "auto"}, "relight": {"shadows": False}}, "`set` needs `relight.shadows: true`"),
    ],
)
def test_contradictions_are_refused(section: dict[str, object], says: str, tmp_path: Path) -> None:
    with pytest.raises(JobError) as caught:
        load_shot(write_tiny_shot(tmp_path / "shot", 1, **section))
    assert says in str(caught.value)


def test_a_missing_mesh_is_named(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 1, set={"mesh": "floor.ply"})
    with pytest.raises(JobError, match=r"floor\.ply"):
        Session(path)


def test_a_subject_on_a_white_floor_is_brighter_below(tmp_path: Path) -> None:
    """Light that the set bounces back; a black floor takes the light from below away."""
    lit = {}
    for name, color in (("dark", 0.0), ("bright", 1.0)):
        path = write_tiny_shot(tmp_path / name, 1, set={"ground": -0.5, "color": [color] * 3})
        lit[name] = delivered(path)
    rows = np.flatnonzero(lit["dark"]["relit.A"].any(axis=1))
    low = rows[-len(rows) // 4 :]
    assert lit["bright"]["relit.G"][low].sum() > 1.5 * lit["dark"]["relit.G"][low].sum()
