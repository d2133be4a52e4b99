"""What a job file says of its lights, frame by frame, down to the delivered pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.inspect.forecast import forecast
from yesnt.io.exr import write_exr
from yesnt.io.pictures.image import read_image
from yesnt.relight import EnvMap, GBuffer, shade
from yesnt.relight.envmap import direction_to_uv, uv_to_direction
from yesnt.runtime.checks.inputs import InputChecks
from yesnt.runtime.session import Session

ROWS = 16


def directions() -> np.ndarray:
    return uv_to_direction((np.arange(2 * ROWS) + 0.5) / (2 * ROWS), (np.arange(ROWS)[:, None] + 0.5) / ROWS)


def lamp(towards: tuple[float, float, float], strength: float = 20.0) -> np.ndarray:
    """A map [16, 32, 3], dim but for a lamp some 30 degrees wide."""
    cosine = directions() @ (np.array(towards) / np.linalg.norm(towards))
    return np.repeat((0.1 + strength * (cosine > 0.93))[..., None], 3, -1).astype(np.float32)


def write_map(path: Path, radiance: np.ndarray) -> None:
    write_exr(path, {c: np.ascontiguousarray(radiance[..., i], np.float32) for i, c in enumerate("RGB")})


def delivered(folder: Path, maps: dict[str, np.ndarray], frame: int = 1001, **job: Any) -> dict[str, np.ndarray]:
    """A shot of two frames whose job says `job` and whose folder holds `maps`; relit and composite of one frame."""
    path = write_tiny_shot(folder, 2, (20, 16), **job)
    for name, radiance in maps.items():
        write_map(folder / name, radiance)
    run_here(path, "composite")
    image = read_image(folder / "out" / "exr" / f"tiny.{frame}.exr")
    return {
        "relit": image.stack([f"relit.{c}" for c in "RGB"]),
        "composite": image.stack("RGB"),
        "matte": image.channels["A"],
    }


def brighter_on_the_right(relit: np.ndarray) -> bool:
    return bool(relit[:, 11:].sum() > 1.3 * relit[:, :9].sum())


RIGHT, LEFT, UP = (1, -0.3, 0), (-1, -0.3, 0), (0, -0.3, 1)


def test_one_map_a_frame_lights_and_backs_each_frame(tmp_path: Path) -> None:
    maps = {"sky.1001.exr": lamp(RIGHT), "sky.1002.exr": lamp(LEFT) + 0.1}
    job = {"light": {"path": "sky.####.exr"}}
    first, second = (delivered(tmp_path / str(f), maps, f, **job) for f in (1001, 1002))
    assert brighter_on_the_right(first["relit"])
    assert not brighter_on_the_right(second["relit"])
    assert np.allclose(second["composite"][0] - first["composite"][0], 0.1, atol=1e-3)


def test_one_capture_map_a_frame_is_taken_out_of_each_plate(tmp_path: Path) -> None:
    even = np.ones((ROWS, 2 * ROWS, 3), np.float32)
    maps = {"shot.1001.exr": even, "shot.1002.exr": 4 * even}
    job = {"capture_light": {"path": "shot.####.exr"}}
    first, second = (delivered(tmp_path / str(f), maps, f, **job)["relit"] for f in (1001, 1002))
    assert 0.15 < second.sum() / first.sum() < 0.5


def test_a_changed_map_of_one_frame_makes_again_that_frame_alone(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path, 2, (20, 16), light={"path": "sky.####.exr"})
    for frame in (1001, 1002):
        write_map(tmp_path / f"sky.{frame}.exr", lamp(RIGHT))
    run_here(path, "composite")
    write_map(tmp_path / "sky.1002.exr", lamp(LEFT))
    todo = {row.stage: row.todo for row in forecast(Session(path)).stages}
    assert (todo["relight"], todo["composite"], todo["solve"]) == (1, 1, 0)


@pytest.mark.parametrize(("axis", "rotation"), [("yaw", [180, 0, 0]), ("pitch", [0, 180, 0]), ("roll", [0, 0, 90])])
def test_all_three_angles_turn_the_light(tmp_path: Path, axis: str, rotation: list[float]) -> None:
    """Yaw and pitch by 180 degrees bring the right to the left; roll by 90 degrees brings what was in front up."""
    source = (0, -1, 0.3) if axis == "roll" else RIGHT
    relit = delivered(tmp_path, {"light.exr": lamp(source)}, light={"path": "light.exr", "rotation": rotation})["relit"]
    if axis == "roll":
        plain = delivered(tmp_path / "plain", {"light.exr": lamp(source)})["relit"]
        top = [image[:7].sum() / image.sum() for image in (relit, plain)]
        assert abs(top[0] - top[1]) > 0.1
    else:
        assert not brighter_on_the_right(relit)


def test_a_stop_of_exposure_doubles_actor_and_background(tmp_path: Path) -> None:
    maps = {"light.exr": lamp(RIGHT)}
    plain = delivered(tmp_path / "plain", maps)
    exposed = delivered(tmp_path / "exposed", maps, light={"path": "light.exr", "exposure": 1})
    for name in ("relit", "composite"):
        np.testing.assert_allclose(exposed[name], 2 * plain[name], rtol=5e-3, atol=1e-4)


def test_an_animated_exposure_is_that_of_the_frame(tmp_path: Path) -> None:
    maps, light = {"light.exr": lamp(RIGHT)}, {"path": "light.exr"}
    for frame, stops in ((1001, 0), (1002, 0.5)):
        moving = {**light, "exposure": {1001: 0, 1003: 1}, "rotation": {1001: [0, 0, 0], 1003: [350, 0, 0]}}
        still = {**light, "exposure": stops, "rotation": [350 * stops, 0, 0]}
        folder = tmp_path / str(frame)
        found, wanted = (delivered(folder / str(i), maps, frame, light=k) for i, k in enumerate((moving, still)))
        for name in ("relit", "composite"):
            np.testing.assert_array_equal(found[name], wanted[name])


@pytest.mark.parametrize(
    ("keys", "warned"), [({1: 0, 25: 3}, True), ({1: 3, 25: 3}, False), ({900: 0, 1002: 1}, False)]
)
def test_keys_that_the_shot_never_meets_are_reported(tmp_path: Path, keys: dict[int, float], warned: bool) -> None:
    light = {"path": "light.exr", "exposure": keys}
    warnings = InputChecks(Session(write_tiny_shot(tmp_path, 2, (20, 16), light=light)).resolved).form()
    told = "light.exposure: its keys are at frames 1,25, and the shot is 1001-1002: it is 3.0 throughout"
    assert (told in warnings) == warned == any(w.startswith("light.") for w in warnings)


@pytest.mark.parametrize("convention", ["opengl", "mitsuba"])
def test_a_map_of_another_convention_lights_alike(tmp_path: Path, convention: str) -> None:
    shift = {"opengl": 8, "mitsuba": -8}[convention]
    other = np.roll(lamp(RIGHT), shift, axis=1)
    plain = delivered(tmp_path / "plain", {"light.exr": lamp(RIGHT)})["composite"]
    named = delivered(tmp_path / "named", {"light.exr": other}, light={"path": "light.exr", "convention": convention})
    np.testing.assert_array_equal(named["composite"], plain)


def test_without_a_background_the_camera_sees_the_map(tmp_path: Path) -> None:
    radiance = np.random.default_rng(0).random((ROWS, 2 * ROWS, 3)).astype(np.float32)
    found = delivered(tmp_path, {"light.exr": radiance})
    rays = Camera.open(tmp_path / "camera.json").rays(1001)
    bare = found["matte"] == 1  # everywhere, over an opaque map
    seen = EnvMap.from_array(radiance).lookup(rays)
    outside = found["relit"].sum(-1) == 0
    np.testing.assert_allclose(found["composite"][outside], seen[outside], rtol=2e-3)
    assert bare.all()


def test_clamp_bounds_the_sun_and_keeps_its_hue(tmp_path: Path) -> None:
    sky = np.full((ROWS, 2 * ROWS, 3), 0.2, np.float32)
    sky[4, 20] = (400, 200, 100)
    held = EnvMap.from_array(sky).clamped(40)
    assert np.allclose(held.radiance[4, 20], (40, 20, 10))
    bounded = delivered(tmp_path / "bounded", {"light.exr": sky}, light={"path": "light.exr", "clamp": 40.0})
    by_hand = delivered(tmp_path / "by_hand", {"light.exr": held.radiance})
    np.testing.assert_array_equal(bounded["composite"], by_hand["composite"])
    assert bounded["relit"].sum() < 0.5 * delivered(tmp_path / "free", {"light.exr": sky})["relit"].sum()


def test_a_map_captured_elsewhere_is_seen_from_the_actors_place() -> None:
    """A lamp 2 m to the right, walked towards by 1 m, is seen at twice the angle; one that is passed lies behind."""
    env = EnvMap.from_array(lamp((1, 0, 0)))
    near = env.seen_from((1, 0, 0), 2)
    lit = [(e.radiance[..., 0] > 5).mean() for e in (env, near)]
    assert lit[1] > 2 * lit[0]
    side = EnvMap.from_array(lamp((1, 1, 0))).seen_from((1.8, 0, 0), 2.0)
    brightest = directions().reshape(-1, 3)[side.radiance[..., 0].argmax()]
    assert brightest[0] < 0 < brightest[1]
    np.testing.assert_allclose(env.seen_from((0, 0, 0), 5).radiance, env.radiance, atol=1e-5)
    with pytest.raises(JobError, match="outside the sphere of the env map"):
        env.seen_from((3, 0, 0), 2)


def test_the_job_moves_a_map_to_the_actor_and_its_background_to_the_camera(tmp_path: Path) -> None:
    spec = {"path": "light.exr", "captured_at": [1.0, 0, 0], "distance": 4.0}
    found = delivered(tmp_path / "moved", {"light.exr": lamp(UP)}, light=spec)
    actor = np.array([0.0, -0.4, 0.0])  # the near side of a sphere of half a metre, as the camera sees it
    at_actor = EnvMap.from_array(lamp(UP)).seen_from(actor - (1, 0, 0), 4).radiance
    close = delivered(tmp_path / "hand", {"light.exr": at_actor})["relit"]
    plain = delivered(tmp_path / "plain", {"light.exr": lamp(UP)})["relit"]
    assert np.abs(found["relit"] - close).mean() < 0.1 * np.abs(found["relit"] - plain).mean()
    camera = Camera.open(tmp_path / "moved" / "camera.json")
    seen = EnvMap.from_array(lamp(UP)).seen_from(camera.position(1001) - (1, 0, 0), 4).lookup(camera.rays(1001))
    outside = found["relit"].sum(-1) == 0
    np.testing.assert_allclose(found["composite"][outside], seen[outside], rtol=2e-3, atol=1e-4)


def test_captured_at_needs_a_distance(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path, 2, light={"path": "light.exr", "captured_at": [0, 0, 0]})
    with pytest.raises(JobError, match="belong together"):
        Session(path)


COLOUR = (0.5, 0.3, 0.2)


def _side_lit(folder: Path, **job: Any) -> Path:
    """The tiny shot as a rough sphere of one colour, its plates lit by a broad lamp on the right."""
    path = write_tiny_shot(folder, 3, (48, 40), **job)
    camera = Camera.open(folder / "camera.json")
    env = EnvMap.from_array(np.repeat(0.2 + 4 * np.clip(directions()[..., :1] - 0.1, 0, 1), 3, -1))
    for frame in (1001, 1002, 1003):
        seen, alpha = (
            read_image(folder / f"gbuffer.{frame}.exr"),
            read_image(folder / f"plate.{frame}.exr").channels["A"],
        )
        normal, one = seen.stack(["N.X", "N.Y", "N.Z"]), np.ones(alpha.shape, np.float32)
        base = np.broadcast_to(np.float32(COLOUR), normal.shape)
        gbuffer = GBuffer(base, 0.9 * one, 0 * one, normal, seen.channels["depth.Z"], alpha)
        lit = shade(gbuffer, env, camera, "draft", False, frame=frame).radiance
        planes = {c: lit[..., i].astype(np.float16) for i, c in enumerate("RGB")}
        write_exr(folder / f"plate.{frame}.exr", planes | {"A": alpha})
        write_exr(folder / f"material.{frame}.exr", {"roughness.Y": 0.9 * one, "metallic.Y": 0 * one})
    return path


def test_the_word_estimate_takes_the_capture_light_from_the_shot(tmp_path: Path) -> None:
    """Estimated, the lamp's shading leaves the base colour; taken for even light, it stays in it."""
    from yesnt.io.store import FrameStore

    uneven = {}
    ways: dict[str, dict[str, Any]] = {"even": {}, "estimate": {"capture_light": "estimate"}}
    for name, job in ways.items():
        path = _side_lit(tmp_path / name, **job)
        base = FrameStore(run_here(path, "relight").output.store).read("base_color", 0)[0]
        inside = read_image(path.parent / "plate.1001.exr").channels["A"] > 0
        uneven[name] = base[inside].std() / base[inside].mean()
    assert uneven["estimate"] < 0.6 * uneven["even"]


def test_an_estimate_depends_on_its_probe_frames_and_says_so(tmp_path: Path) -> None:
    path = _side_lit(tmp_path, capture_light="estimate")
    run_here(path, "relight")
    assert not any("capture" in line for line in forecast(Session(path)).left_out)
    plate = tmp_path / "plate.1003.exr"
    channels = read_image(plate).channels
    write_exr(plate, {**channels, "R": (channels["R"] * 0.5).astype(np.float16)})
    todo = {row.stage: row.todo for row in forecast(Session(path)).stages}
    assert todo["relight"] == 3


def test_the_capture_light_is_a_map_or_an_estimate(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path, 2, capture_light={"exposure": 1.0})
    with pytest.raises(JobError, match="path or the word `estimate`"):
        Session(path)
    job = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**job, "capture_light": "guess"}))
    with pytest.raises(JobError, match="capture_light"):
        Session(path)


def test_disney_diffuse_is_reached_from_the_job(tmp_path: Path) -> None:
    knobs = {"texels": 8, "capture_texels": 4, "clusters": 8, "capture_clusters": 8}
    plain, rough = (
        delivered(tmp_path / d, {}, relight={**knobs, "diffuse": d}, quality="draft")["relit"]
        for d in ("lambert", "disney")
    )
    assert 1e-3 < np.abs(plain - rough).max() < 0.5 * plain.max()


def test_directions_of_the_helper_are_the_products() -> None:
    u, v = direction_to_uv(directions())
    assert np.allclose(u[0], (np.arange(2 * ROWS) + 0.5) / (2 * ROWS))
    assert np.allclose(v[:, 0], (np.arange(ROWS) + 0.5) / ROWS)


def test_plan_reads_the_passes_and_leaves_out_what_they_lack(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path, 2, (20, 16))
    left_out = " ".join(forecast(Session(path)).left_out)
    assert "metallic lobe" not in left_out
    for frame in (1001, 1002):
        passes = {"roughness.Y": np.full((16, 20), 0.5, np.float16), "metallic.Y": np.zeros((16, 20), np.float16)}
        write_exr(tmp_path / f"material.{frame}.exr", passes)
    left_out = " ".join(forecast(Session(path)).left_out)
    assert "metallic lobe: no pixel is metallic" in left_out
    assert "map filtered for metal in metal: n" in left_out  # nothing bounces, or no pixel is metallic
