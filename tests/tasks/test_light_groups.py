"""Light groups of a job: the composite as the sum of what the map's sun gives and the rest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.in_process import run_here
from tests.nuke_script import Nuke
from tests.relight.scenes import box_mesh
from tests.tiny_shot import write_tiny_shot
from yesnt.capture_stage.tools import find_tools, run_script
from yesnt.core.errors import JobError, MissingPartError
from yesnt.io.exr import read_planes, write_exr
from yesnt.io.jobfile import load_shot
from yesnt.io.pictures.image import read_image
from yesnt.relight import EnvMap
from yesnt.relight.sun import Sun, find_sun
from yesnt.runtime.checks.inputs import inspect
from yesnt.runtime.session import Session
from yesnt.tasks import light

F32 = np.ndarray
COMPOSITE_IN_BLENDER = Path(__file__).parents[1] / "io" / "composite_in_blender.py"
BOTH = {"layers": ["light_sun", "light_rest"]}
ROWS = 32

JOBS: dict[str, dict[str, Any]] = {
    "alone": {},
    "single": {"relight": {"shadows": "single", "texels": 64}},
    "plate": {"background": {"path": "bg.exr"}},
    "show": {"set": {"ground": "auto"}},
    "mirror": {"set": {"ground": "auto", "roughness": 0.02, "metallic": 1.0}},
    "catch": {"set": {"ground": -0.5, "mode": "catch"}, "background": {"path": "bg.exr"}},
    "wall": {"set": {"mesh": "wall.ply"}},
}
"""Sections of jobs by name."""


def write_sunny_shot(folder: Path, sun: float = 300.0, **changes: Any) -> Path:
    """The tiny shot under a sky with a sun on the right, with a plate and a wall."""
    import trimesh

    path = write_tiny_shot(folder, 1, **{"quality": "draft", "relight": None, **changes})
    sky = np.broadcast_to(np.array([0.2, 0.4, 0.8], np.float32), (ROWS, 2 * ROWS, 3)).copy()
    sky[ROWS // 2 :] = 0.1
    sky[8:10, 39:41] += np.float32(sun)
    plate = np.random.default_rng(1).uniform(0.1, 1, (32, 40, 3)).astype(np.float32)
    for name, image in (("light", sky), ("bg", plate)):
        write_exr(path.parent / f"{name}.exr", {c: np.ascontiguousarray(image[..., i]) for i, c in enumerate("RGB")})
    trimesh.Trimesh(*box_mesh((-0.9, -1.0, -0.6), (0.0, -0.9, 0.6)), process=False).export(folder / "wall.ply")
    return path


def delivered(path: Path) -> dict[str, F32]:
    image = read_image(run_here(path, "composite").output.exr_path("tiny", 1001))
    return {name: np.asarray(plane, np.float32) for name, plane in image.channels.items()}


def rgb(planes: dict[str, F32], layer: str = "") -> F32:
    return np.stack([planes[f"{layer}.{c}" if layer else c] for c in "RGB"], axis=-1)


@pytest.mark.parametrize("name", JOBS)
def test_the_groups_sum_up_to_the_composite(name: str, tmp_path: Path) -> None:
    path = write_sunny_shot(tmp_path / "shot", exr=BOTH, **JOBS[name])
    planes = delivered(path)
    sun, rest, whole = rgb(planes, "light_sun"), rgb(planes, "light_rest"), rgb(planes)
    np.testing.assert_allclose(sun + rest, whole, rtol=1e-3, atol=1e-5)
    assert sun.min() >= 0
    assert rest.min() > -2e-3 * whole.max()
    assert 0.1 < sun.mean() / whole.mean() < 0.9
    script = (path.parent / "out" / "exr" / "tiny.nk").read_text()
    np.testing.assert_allclose(Nuke(planes).run(script)[..., :3], whole, rtol=1e-3, atol=1e-5)


def test_a_stronger_sun_is_the_suns_layer_times_its_strength(tmp_path: Path) -> None:
    """What a compositor relies on. Texels and clusters follow the light, so that a little differs."""
    planes = delivered(write_sunny_shot(tmp_path / "shot", exr=BOTH))
    again = rgb(delivered(write_sunny_shot(tmp_path / "again", sun=900.0)))
    expected = 3 * rgb(planes, "light_sun") + rgb(planes, "light_rest")
    assert np.abs(again - expected).mean() < 0.003 * again.mean()
    assert np.abs(again - rgb(planes)).mean() > 0.2 * again.mean(), "the test can fail"


@pytest.mark.blender
@pytest.mark.parametrize("name", ["alone", "show", "catch", "wall"])
def test_blenders_compositor_makes_the_delivered_composite(name: str, tmp_path: Path) -> None:
    """The script beside the sequence, run on what was delivered: holdout, plate and light groups."""
    try:
        tools = find_tools(tmp_path)
    except MissingPartError as error:
        pytest.skip(str(error))
    path = write_sunny_shot(tmp_path / "shot", exr=BOTH, **JOBS[name])
    planes, folder = delivered(path), path.parent / "out" / "exr"
    run_script(tools, COMPOSITE_IN_BLENDER, ["1.0", "1.0", str(folder / "tiny_layers.py")], 300.0)
    found = read_planes(folder / "composited.1001.exr")
    for c in "RGBA":
        np.testing.assert_allclose(found[c], planes[c], rtol=1e-3, atol=1e-3, err_msg=c)


@pytest.mark.parametrize("name", ["single", "show", "mirror", "wall"])
def test_the_rest_is_what_the_map_without_its_sun_gives(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`light_rest` is a difference; here the map without its sun is taken for the sun, and lights all there is."""
    planes = delivered(write_sunny_shot(tmp_path / "shot", exr=BOTH, **JOBS[name]))

    def rest(env: EnvMap) -> Sun:
        found = find_sun(env)
        return Sun(replace(env, radiance=env.radiance - found.env.radiance), 1 - found.share, 0)

    monkeypatch.setattr("yesnt.relight.sun.find_sun", rest)
    with fresh_caches():
        again = delivered(write_sunny_shot(tmp_path / "again", exr=BOTH, **JOBS[name]))
    apart, whole = np.abs(rgb(again, "light_sun") - rgb(planes, "light_rest")), rgb(planes, "light_rest")
    assert apart.mean() < 2e-3 * whole.mean()
    assert apart.max() < 0.04 * whole.max()


@contextmanager
def fresh_caches() -> Iterator[None]:
    """Forgets what a worker remembers of suns, before and after."""
    remembered = light._sun, light._prepared_sun
    for cache in remembered:
        cache.cache_clear()
    yield
    for cache in remembered:
        cache.cache_clear()


def test_a_plate_is_in_the_rest(tmp_path: Path) -> None:
    planes = delivered(write_sunny_shot(tmp_path / "shot", exr=BOTH, **JOBS["catch"]))
    free = (planes["relit.A"] == 0) & (np.arange(32) < 12)[:, None]  # above the horizon
    assert free.any()
    assert not rgb(planes, "light_sun")[free].any()
    np.testing.assert_array_equal(rgb(planes, "light_rest")[free], rgb(planes)[free])


def test_what_is_not_asked_for_is_not_there(tmp_path: Path) -> None:
    path = write_sunny_shot(tmp_path / "shot", exr={"layers": ["light_sun"]})
    planes = delivered(path)
    assert "light_sun.R" in planes
    assert "light_rest.R" not in planes
    assert not (path.parent / "out" / "exr" / "tiny.nk").exists()
    path = write_sunny_shot(tmp_path / "usual", **JOBS["show"])
    assert not {"sun_diffuse", "sun_specular", "set_sun"} & set(Session(path).plan().arrays())


def test_a_map_without_sun_gives_a_black_layer_and_says_so(tmp_path: Path) -> None:
    path = write_sunny_shot(tmp_path / "shot", sun=0.0, exr=BOTH, **JOBS["show"])
    told = [line for line in inspect(Session(path).resolved) if "light_sun" in line]
    assert len(told) == 1
    assert "has no small, bright lamp: `light_sun` will be black, and `light_rest` the whole composite" in told[0]
    planes = delivered(path)
    assert not rgb(planes, "light_sun").any()
    np.testing.assert_array_equal(rgb(planes, "light_rest"), rgb(planes))


def test_several_lamps_are_counted(tmp_path: Path) -> None:
    path = write_sunny_shot(tmp_path / "shot", exr=BOTH)
    sky = np.full((ROWS, 2 * ROWS, 3), 0.2, np.float32)
    sky[8:10, 39:41], sky[8:10, 4:6] = 300, 200
    write_exr(path.parent / "light.exr", {c: np.ascontiguousarray(sky[..., i]) for i, c in enumerate("RGB")})
    told = [line for line in inspect(Session(path).resolved) if "light_sun" in line]
    assert len(told) == 1
    assert "`light_sun` is the strongest lamp of" in told[0]
    assert "1 more are in `light_rest`" in told[0]


def test_groups_of_a_scene_of_blender_are_refused(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 1, exr=BOTH, set={"blend": "a.blend"})
    with pytest.raises(JobError) as caught:
        load_shot(path)
    assert "need a light of the job alone; the lamps of a scene of Blender are not told apart" in str(caught.value)
