"""Sides that the delivered view does not show: which jobs measure them by the capture's cameras, and what they find."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.capture.capture_shot import pictures_of, write_capture_shot, write_view
from tests.decompose.evidence.scenes import paint
from tests.in_process import run_here
from yesnt.planning.stages import EVIDENCE, SET
from yesnt.relight import ProxyScene
from yesnt.runtime.session import Session
from yesnt.scene.vertex_materials import MeasuredVertices, shown_vertices
from yesnt.tasks import set_stage
from yesnt.tasks.workspace import Workspace

MIRROR = {"ground": "auto", "roughness": 0.0, "metallic": 1.0}


def node_of(path: Path) -> Any:
    return Session(path).graph().committer(SET, 1001)


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_capture_shot(tmp_path_factory.mktemp("sides"), frames=1, set=MIRROR)


def test_a_mirror_is_shown_what_cameras_measure_and_a_dull_ground_is_not(mirrored: Path, tmp_path: Path) -> None:
    session = Session(mirrored)
    measured = session.graph().committer(EVIDENCE, 1001)
    assert node_of(mirrored).task.cameras == measured.task.cameras != ()
    dull = write_capture_shot(tmp_path / "dull", frames=1, set={"ground": "auto"})
    assert node_of(dull).task.cameras == ()
    assert not any(role.startswith("view ") for role in node_of(dull).inputs)
    between = write_capture_shot(tmp_path / "between", frames=3, set=MIRROR, evidence={"every": 2})
    assert node_of(between).task.cameras == (), "frames between have no cameras: the sides would flicker"


def test_another_picture_of_a_camera_is_another_set(mirrored: Path, tmp_path: Path) -> None:
    path = write_capture_shot(tmp_path, frames=1, set=MIRROR)
    assert node_of(path).key == node_of(mirrored).key
    _, color, matte, *_ = pictures_of(5)[1]
    write_view(tmp_path, "c00", 1001, 0.5 * color, matte)
    assert node_of(path).key != node_of(mirrored).key


def test_the_vertices_that_the_plate_does_not_show_have_the_colours_of_the_cameras(
    mirrored: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[tuple[MeasuredVertices, Any, ProxyScene]] = []
    measure = set_stage.measured_sides

    def spy(space: Workspace[Any], views: Any, surface: Any, proxy: ProxyScene) -> MeasuredVertices | None:
        made = measure(space, views, surface, proxy)
        assert made is not None
        found.append((made, surface, proxy))
        return made

    monkeypatch.setattr(set_stage, "measured_sides", spy)
    run_here(mirrored, "set")
    (made, surface, proxy), opacity, z = found[0], *(np.asarray(a) for a in (found[0][1].opacity, found[0][1].z))
    seen = shown_vertices(proxy.vertices, (surface.camera, surface.frame), opacity, z)
    assert made.known.sum() > 100
    assert not (made.known & seen).any()
    painted = paint(proxy.vertices.astype(float))
    inner = made.known & (np.abs(proxy.vertices[:, 0] * 2 % 1 - 0.5) < 0.35) & (painted.metallic == 0)
    assert inner.any()
    assert np.abs(made.values[inner, :3] - painted.base[inner]).mean() < 0.1
