"""Inputs that contradict each other or the camera: reported with a percentage, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.cases.shots import (
    FRAME,
    POSE,
    POSE_OPENGL,
    camera,
    check,
    gbuffer,
    material,
    sky,
    sky_with_sun,
    sphere,
    write,
    write_json,
    write_mesh,
    write_proxy,
    write_shot,
)

SPHERE = sphere()
TO_CAMERA_AXES = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
Change = Callable[[Path], None]


def pose(values: tuple[float, ...]) -> Change:
    """A camera of another pose."""
    return lambda folder: write_json(folder / "camera.json", camera(pose=values))


def normals(values: np.ndarray) -> Change:
    """A G-buffer of other normals."""
    return lambda folder: write(folder / f"gbuffer.{FRAME}.exr", gbuffer(SPHERE, normal=values))


def depths(values: np.ndarray) -> Change:
    """A G-buffer of other depths."""
    return lambda folder: write(folder / f"gbuffer.{FRAME}.exr", gbuffer(SPHERE, z=values))


def proxy(**changes: object) -> Change:
    """A proxy of another size or place."""
    return lambda folder: write_proxy(folder / f"proxy.{FRAME}.ply", **changes)  # type: ignore[arg-type]


def point_proxy(folder: Path) -> None:
    """A proxy of one triangle without area."""
    write_mesh(folder / f"proxy.{FRAME}.ply", np.zeros((3, 3)), np.array([[0, 1, 2]]))


def roughness_255(folder: Path) -> None:
    """A roughness pass in 0 to 255."""
    write(folder / f"material.{FRAME}.exr", material(roughness=128.0))


INSIDE = SPHERE.hit[..., None]
MISTAKES: dict[str, Change] = {
    "column-major pose": pose(tuple(np.array(POSE).reshape(4, 4).T.ravel().tolist())),
    "last row 0 0 0 5": pose((*POSE[:12], 0, 0, 0, 5)),
    "OpenGL camera axes": pose(POSE_OPENGL),
    "camera normals called world": normals(SPHERE.normal @ TO_CAMERA_AXES),
    "normals coded 0..1": normals(np.where(INSIDE, SPHERE.normal * 0.5 + 0.5, 0.5)),
    "normals flipped": normals(-SPHERE.normal),
    "normals all 0": normals(SPHERE.normal * 0),
    "z in millimetres": depths(np.where(SPHERE.hit, SPHERE.z * 1000, 1e10)),
    "z inverse": depths(np.where(SPHERE.hit, 1 / np.maximum(SPHERE.z, 1e-6), 0)),
    "proxy in millimetres": proxy(scale=1000.0),
    "proxy 1e6 m away": proxy(centre=(1e6, 0, 0)),
    "proxy of degenerate faces": point_proxy,
    "roughness 0..255": roughness_255,
}


def write_checked_shot(folder: Path) -> Path:
    """A shot with a proxy under a sun, all of whose inputs agree."""
    write_shot(folder, proxy={"path": "proxy.####.ply"})
    write(folder / "light.exr", sky(sky_with_sun()))
    write_proxy(folder / f"proxy.{FRAME}.ply")
    return folder


def test_inputs_that_agree_raise_no_warning(tmp_path: Path) -> None:
    assert not check(write_checked_shot(tmp_path / "s")).reported


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_contradiction_is_reported(tmp_path: Path, mistake: str) -> None:
    folder = write_checked_shot(tmp_path / "s")
    MISTAKES[mistake](folder)
    outcome = check(folder)
    assert outcome.refusal or any("%" in warning for warning in outcome.warnings)
