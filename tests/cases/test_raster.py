"""Windows, pixel aspect ratio and metadata from the plate to the delivered file."""

from __future__ import annotations

import json
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from tests.cases.shots import (
    FRAME,
    HEIGHT,
    WIDTH,
    Outcome,
    camera,
    check,
    deliver,
    gbuffer,
    material,
    rgba,
    sky,
    sphere,
    window,
    write,
    write_json,
    write_shot,
)
from tests.io.exr_bytes import Raw, write_raw
from yesnt.inspect.forecast import forecast
from yesnt.io.shot_inputs import read_plate
from yesnt.runtime.session import Session

PLATE = f"plate.{FRAME}.exr"


def delivered(outcome: Outcome) -> Outcome:
    """The outcome, which must hold a delivered picture."""
    assert outcome.refusal == ""
    return outcome


def write_small(folder: Path, mark: tuple[int, int]) -> Path:
    """An 8x8 display under a 12x10 data window at (-2, -1); one bright pixel `mark`, counted from the display."""
    write_shot(folder, size=(8, 8))
    windows = {"dataWindow": window(-2, -1, 12, 10), "displayWindow": window(0, 0, 8, 8)}
    ones = np.ones((10, 12))
    color = np.full((10, 12, 3), 0.25)
    color[mark[1] + 1, mark[0] + 2] = 0.75
    write(folder / PLATE, rgba(color, ones), **windows)
    seen = sphere(8, 8)
    write(folder / f"gbuffer.{FRAME}.exr", {n: np.pad(p, ((1, 1), (2, 2)), "edge") for n, p in gbuffer(seen).items()},
          **windows)  # fmt: skip
    write(folder / f"material.{FRAME}.exr", material(shape=(8, 8)))
    return folder


def test_both_windows_return_and_land_on_the_plate(tmp_path: Path) -> None:
    folder = write_small(tmp_path / "s", mark=(4, 4))
    outcome = delivered(deliver(folder))
    assert outcome.header["dataWindow"] == ((-2, -1), (9, 8))
    assert outcome.header["displayWindow"] == ((0, 0), (7, 7))
    relit = outcome.planes["relit.R"]
    assert relit.shape == (10, 12)
    y, x = np.unravel_index(np.argmax(relit), relit.shape)
    assert (x - 2, y - 1) == (4, 4)


def test_a_camera_looks_through_the_display_window(tmp_path: Path) -> None:
    folder = write_small(tmp_path / "s", mark=(4, 4))
    background = delivered(deliver(folder)).planes
    plain = write_shot(tmp_path / "plain", size=(8, 8))
    light = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    for one in (folder, plain):
        write(one / "light.exr", sky(light))
        write(
            one / PLATE,
            rgba(0, np.zeros((10, 12))) if one == folder else rgba(0, np.zeros((8, 8))),
            **({"dataWindow": window(-2, -1, 12, 10), "displayWindow": window(0, 0, 8, 8)} if one == folder else {}),
        )
    inside, alone = delivered(deliver(folder)).planes["G"], delivered(deliver(plain)).planes["G"]
    np.testing.assert_array_equal(inside[1:9, 2:10], alone)
    assert background["G"].shape == inside.shape


def test_a_display_window_away_from_the_origin_returns(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    both = window(10, 20, WIDTH, HEIGHT)
    write(folder / PLATE, rgba(0.5, sphere().matte), dataWindow=both, displayWindow=both)
    outcome = delivered(deliver(folder))
    assert outcome.header["dataWindow"] == outcome.header["displayWindow"] == ((10, 20), (73, 67))
    assert outcome.centre() == pytest.approx([0.5] * 3, abs=2e-3)


def chrome_ball(folder: Path, aspect: float) -> Path:
    """A mirror ball under a dark sky with a small sun, seen through pixels of an aspect ratio."""
    write_shot(folder, decompose={"path": "material.####.exr"}, relight={"texels": 64, "rows": 64})
    width = round(WIDTH / aspect)
    document = camera(size=(width, HEIGHT), fx=1.6 * WIDTH / aspect, fy=1.6 * WIDTH)
    write_json(folder / "camera.json", document)
    x = (np.arange(width) + 0.5 - width / 2) / document["fx"]
    y = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / document["fy"]
    rays = np.stack([*np.broadcast_arrays(x[None], np.ones((1, 1)), -y[:, None])], -1)
    b, c = rays @ [0, -3.0, 0], 9 - 0.25
    root = b * b - (rays**2).sum(-1) * c
    hit, z = root > 0, (-b - np.sqrt(np.maximum(root, 0))) / (rays**2).sum(-1)
    normal = np.where(hit[..., None], ([0, -3.0, 0] + z[..., None] * rays) / 0.5, 0)
    planes = {f"N.{c}": normal[..., i].astype(np.float32) for i, c in enumerate("XYZ")}
    write(folder / PLATE, rgba(0.9, hit.astype(np.float32)), pixelAspectRatio=aspect)
    write(folder / f"gbuffer.{FRAME}.exr", planes | {"depth.Z": np.where(hit, z, 1e10).astype(np.float32)})
    write(folder / f"material.{FRAME}.exr", material(0.02, 1.0, (HEIGHT, width)))
    return folder


SUN = (90, 41)
"""Column and row of the sun's texel in a map of 64 x 128."""


def sun_on_ball(fx: float, fy: float, width: int) -> tuple[float, float]:
    """Where a mirror ball of radius .5, 3 m ahead, shows the sun: pixels, by its geometry."""
    u, v = (SUN[0] + 0.5) / 128, (SUN[1] + 0.5) / 64
    phi, theta = 2 * np.pi * (0.5 - u), np.pi * v
    sun = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    best = np.array([0.0, -1.0, 0.0])
    for _ in range(100):  # the normal halves the angle between the sun and the eye
        to_eye = np.array([0, -3.0, 0]) - 0.5 * best
        half = sun + to_eye / np.linalg.norm(to_eye)
        best = half / np.linalg.norm(half)
    point = 0.5 * best - np.array([0, -3.0, 0])
    return fx * point[0] / point[1] + width / 2, -fy * point[2] / point[1] + HEIGHT / 2


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_a_chrome_ball_shows_the_sun_where_geometry_says(tmp_path: Path, aspect: float) -> None:
    folder = chrome_ball(tmp_path / "s", aspect)
    light = np.full((64, 128, 3), 0.01, np.float32)
    light[SUN[1], SUN[0]] = 2000
    write(folder / "light.exr", {c: light[..., i] for i, c in enumerate("RGB")})
    outcome = delivered(deliver(folder))
    image = outcome.planes["specular.G"].astype(np.float64)
    image = np.where(image > 0.5 * image.max(), image, 0)
    y, x = (np.arange(n) + 0.5 for n in image.shape)
    found = float((image.sum(0) * x).sum() / image.sum()), float((image.sum(1) * y).sum() / image.sum())
    expected = sun_on_ball(1.6 * WIDTH / aspect, 1.6 * WIDTH, image.shape[1])
    assert found == pytest.approx(expected, abs=0.5)
    assert outcome.header["pixelAspectRatio"] == aspect


def test_rate_and_timecode_return_and_the_owner_does_not(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    attributes = {
        "framesPerSecond": ("rational", struct.pack("<iI", 24000, 1001)),
        "timeCode": ("timecode", struct.pack("<II", 0x01020304, 0)),
        "expTime": ("float", struct.pack("<f", 0.02)),
        "owner": ("string", b"a studio"),
        "reelName": ("int", struct.pack("<i", 7)),
    }
    write_raw(folder / PLATE, Raw(rgba(0.5, sphere().matte, np.float16), attributes=attributes))
    header = delivered(deliver(folder)).header
    assert header["framesPerSecond"] == Fraction(24000, 1001)
    assert str(header["timeCode"]) == str(OpenEXR.File(str(folder / PLATE), header_only=True).header()["timeCode"])
    assert header["expTime"] == pytest.approx(0.02)
    assert not {"owner", "reelName"} & set(header), "not on the list, or of another type than EXR's"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pixelAspectRatio": 2.0}, "another pixel aspect ratio than the first: 2.0"),
        ({"displayWindow": window(0, 0, 80, 48)}, "another display window than the first: 80x48"),
    ],
)
def test_a_plate_unlike_the_first_is_refused(tmp_path: Path, change: dict, message: str) -> None:
    folder = write_shot(tmp_path / "s", (FRAME, FRAME + 1))
    write(folder / f"plate.{FRAME + 1}.exr", rgba(0.5, sphere().matte), **change)
    refusal = check_refusal(folder)
    assert message in refusal
    assert f"plate.{FRAME + 1}.exr" in refusal


def check_refusal(folder: Path) -> str:
    return check(folder).refusal


def test_an_input_of_another_display_window_is_refused(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / f"gbuffer.{FRAME}.exr", gbuffer(sphere()), displayWindow=window(0, 0, 80, 60))
    assert "The picture is 80x60" in check(folder).refusal


def test_autocropped_boxes_of_every_frame_are_placed(tmp_path: Path) -> None:
    frames = (FRAME, FRAME + 1)
    folder, matte = write_shot(tmp_path / "s", frames), sphere().matte
    for frame, (left, top) in zip(frames, [(16, 8), (20, 4)], strict=True):
        box = {n: p[top:44, left:52] for n, p in rgba(0.5, matte).items()}
        write(folder / f"plate.{frame}.exr", box, dataWindow=window(left, top, 52 - left, 44 - top),
              displayWindow=window(0, 0, WIDTH, HEIGHT))  # fmt: skip
    job = Session(folder).job
    assert job.raster is None
    for frame, (left, top) in zip(frames, [(16, 8), (20, 4)], strict=True):
        expected = matte.copy()
        expected[:, :left], expected[:top] = 0, 0
        np.testing.assert_array_equal(read_plate(job, frame).matte, expected)


def test_usual_plates_have_no_raster(tmp_path: Path) -> None:
    assert Session(write_shot(tmp_path / "s")).job.raster is None


def test_a_camera_of_the_data_windows_size_is_taken_so_and_reported(tmp_path: Path) -> None:
    folder = write_small(tmp_path / "s", mark=(4, 4))
    display = json.loads((folder / "camera.json").read_text())
    moved = {"width": 12, "height": 10, "cx": display["cx"] + 2, "cy": display["cy"] + 1}
    light = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    write(folder / "light.exr", sky(light))
    first = delivered(deliver(folder)).planes["G"]
    write_json(folder / "camera.json", display | moved)
    outcome = delivered(deliver(folder))
    np.testing.assert_array_equal(outcome.planes["G"], first)
    assert "camera: its size 12x10 is that of the plates' data windows" in " ".join(outcome.warnings)


def test_fx_that_does_not_fit_the_aspect_is_reported(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(0.5, sphere().matte), pixelAspectRatio=2.0)
    assert "times the plates' pixel aspect ratio 2 is not fy" in " ".join(check(folder).warnings)


def test_plan_says_what_is_read_and_how_the_pixels_lie(tmp_path: Path) -> None:
    folder = write_small(tmp_path / "s", mark=(4, 4))
    reads = forecast(Session(folder)).reads
    assert "plate: R, G, B, A, premultiplied, lin_rec709" in reads
    assert "z: depth.Z" in reads
    assert "normals: N.X, N.Y, N.Z" in reads
    windows = "data window 12x10 at (-2, -1), display window 8x8 at (0, 0)"
    assert f"pixels: {windows}: all of the data is relit and delivered" in reads


def test_where_the_display_window_lies_does_not_matter(tmp_path: Path) -> None:
    found = []
    for left, top in ((0, 0), (10, 20)):
        folder = write_shot(tmp_path / str(left), size=(8, 8))
        write(folder / "light.exr", sky(np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)))
        write(folder / PLATE, rgba(0, np.zeros((10, 12))), dataWindow=window(left - 2, top - 1, 12, 10),
              displayWindow=window(left, top, 8, 8))  # fmt: skip
        found.append(delivered(deliver(folder)))
    assert found[1].header["dataWindow"] == ((8, 19), (19, 28))
    np.testing.assert_array_equal(found[0].planes["G"], found[1].planes["G"])


def test_a_camera_of_a_cropped_data_window_is_taken_so(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", size=(8, 8))
    write(folder / "light.exr", sky(np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)))
    whole = delivered(deliver(folder)).planes["G"]
    crop = {name: plane[2:6, 3:8] for name, plane in rgba(0.5, sphere(8, 8).matte).items()}
    write(folder / PLATE, crop, dataWindow=window(3, 2, 5, 4), displayWindow=window(0, 0, 8, 8))
    document = json.loads((folder / "camera.json").read_text())
    write_json(folder / "camera.json", document | {"width": 5, "height": 4, "cx": 4 - 3, "cy": 4 - 2})
    outside = sphere(8, 8).matte == 0
    np.testing.assert_array_equal(delivered(deliver(folder)).planes["G"][outside], whole[outside])


def test_a_cropped_plate_without_alpha_covers_its_data_window(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", size=(8, 8))
    write(folder / PLATE, dict.fromkeys("RGB", np.full((4, 5), 0.5, np.float32)), dataWindow=window(3, 2, 5, 4),
          displayWindow=window(0, 0, 8, 8))  # fmt: skip
    expected = np.zeros((8, 8))
    expected[2:6, 3:8] = 1
    np.testing.assert_array_equal(read_plate(Session(folder).job, FRAME).matte, expected)
