"""Windows, layers, parts and attributes of pictures as Blender, Nuke and others write them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cases.shots import (
    FRAME,
    HEIGHT,
    WIDTH,
    Outcome,
    camera,
    deliver,
    display_window,
    gbuffer,
    material,
    rgba,
    sky,
    sphere,
    stored,
    window,
    write,
    write_json,
    write_parts,
    write_shot,
)
from yesnt.core.errors import JobError
from yesnt.io.pictures.image import read_image
from yesnt.io.shot_inputs import read_matte
from yesnt.runtime.session import Session

SPHERE = sphere()
PLATE = f"plate.{FRAME}.exr"
GBUFFER = f"gbuffer.{FRAME}.exr"
MATERIAL = f"material.{FRAME}.exr"


def finished(outcome: Outcome) -> Outcome:
    """The outcome, which must hold a delivered picture."""
    assert outcome.refusal == ""
    return outcome


def wrong_matte_pixels(folder: Path) -> int:
    """Pixels of the display window in which the matte is not the sphere's, and pixels outside in which there is any."""
    try:
        job = Session(folder).job
        matte = read_matte(job, FRAME)
    except JobError as refused:
        raise AssertionError(f"the plate is refused: {refused}") from refused
    left, top = -job.window.left, -job.window.top
    shown = matte[top : top + HEIGHT, left : left + WIDTH]
    return int((shown != SPHERE.matte).sum() + (matte > 0).sum() - (shown > 0).sum())


def test_a_deep_picture_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "deep.exr"
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 4, oiio.FLOAT)
    spec.channelnames, spec.deep = tuple("RGBA"), True
    data = oiio.DeepData()
    data.init(WIDTH * HEIGHT, 4, [oiio.TypeFloat] * 4, list("RGBA"))
    for pixel in range(WIDTH * HEIGHT):
        data.set_samples(pixel, 1)
        for channel in range(4):
            data.set_deep_value(pixel, channel, 0, 0.5)
    target = oiio.ImageOutput.create(str(path))
    target.open(str(path), spec)
    target.write_deep_image(data)
    target.close()
    with pytest.raises(JobError, match="deep"):
        read_image(path)


def test_a_plate_whose_data_window_is_shifted_is_placed(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    moved = {name: np.roll(plane, (5, 7), (0, 1)) for name, plane in rgba(0.5, SPHERE.matte).items()}
    write(folder / PLATE, moved, dataWindow=window(-7, -5, WIDTH, HEIGHT), **display_window())
    assert wrong_matte_pixels(folder) == 0


def test_a_data_window_beyond_the_display_window_is_placed(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    moved = {name: np.roll(plane, (-4, -8), (0, 1)) for name, plane in rgba(0.5, SPHERE.matte).items()}
    write(folder / PLATE, moved, dataWindow=window(8, 4, WIDTH, HEIGHT), **display_window())
    assert wrong_matte_pixels(folder) == 0


def test_a_crop_of_the_display_window_is_padded(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    crop = {name: plane[4:44, 12:52] for name, plane in rgba(0.5, SPHERE.matte).items()}
    write(folder / PLATE, crop, dataWindow=window(12, 4, 40, 40), **display_window())
    assert wrong_matte_pixels(folder) == 0


def write_overscan(folder: Path) -> Path:
    """All pictures have 8 columns and 6 rows more on every side than the display window."""
    write_shot(folder)
    planes = {PLATE: rgba(0.5, SPHERE.matte), GBUFFER: gbuffer(SPHERE), MATERIAL: material()}
    for name, inside in planes.items():
        padded = {channel: np.pad(plane, ((6, 6), (8, 8))) for channel, plane in inside.items()}
        write(folder / name, padded, dataWindow=window(-8, -6, WIDTH + 16, HEIGHT + 12), **display_window())
    return folder


@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (WIDTH + 16, HEIGHT + 12)], ids=["display size", "data size"])
def test_overscan_is_kept_to_the_output(tmp_path: Path, size: tuple[int, int]) -> None:
    folder = write_overscan(tmp_path / "s")
    intrinsics = {"fx": 1.6 * WIDTH, "fy": 1.6 * WIDTH}
    write_json(folder / "camera.json", camera(size=size, **intrinsics))
    header = finished(deliver(folder)).header
    assert header["dataWindow"] == ((-8, -6), (WIDTH + 7, HEIGHT + 5))
    assert header["displayWindow"] == ((0, 0), (WIDTH - 1, HEIGHT - 1))


def test_pixel_aspect_ratio_is_kept(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(0.5, SPHERE.matte), pixelAspectRatio=2.0)
    document = json.loads((folder / "camera.json").read_text())
    write_json(folder / "camera.json", document | {"fx": document["fx"] / 2})
    assert finished(deliver(folder)).header["pixelAspectRatio"] == 2.0


NUKE = {"R": "rgba.red", "G": "rgba.green", "B": "rgba.blue", "A": "rgba.alpha"}
LAYER = {c: f"rgba.{c}" for c in "RGBA"}


@pytest.mark.parametrize("names", [LAYER, NUKE], ids=["rgba.R", "rgba.red"])
def test_a_plate_in_a_layer_is_found(tmp_path: Path, names: dict[str, str]) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, {names[c]: plane for c, plane in rgba(0.5, SPHERE.matte).items()})
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def test_normals_under_nukes_names_are_found(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    names = {"N.X": "N.red", "N.Y": "N.green", "N.Z": "N.blue"}
    write(folder / GBUFFER, {names.get(name, name): plane for name, plane in gbuffer(SPHERE).items()})
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def test_a_beauty_in_the_second_part_is_found(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    depth = {"Z": SPHERE.z.astype(np.float32)}
    write_parts(folder / PLATE, {"depth": depth, "beauty": rgba(0.5, SPHERE.matte)})
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def test_plate_and_gbuffer_may_be_parts_of_one_file(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", gbuffer={"path": "plate.####.exr"})
    write_parts(folder / PLATE, {"rgba": rgba(0.5, SPHERE.matte), "gb": gbuffer(SPHERE)})
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def test_a_plate_of_134_channels_is_read(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    others = {f"a{i}.R": SPHERE.matte.astype(np.float16) for i in range(130)}
    write(folder / PLATE, rgba(0.5, SPHERE.matte, np.float16) | others)
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def test_a_plate_with_an_object_id_is_read(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(0.5, SPHERE.matte) | {"objectId": SPHERE.hit.astype(np.uint32)})
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def write_glow(path: Path, planes: dict[str, np.ndarray]) -> None:
    """A pixel of colour .8 that covers nothing: a flame, or a reflection."""
    for name in "RGB":
        planes[name][2, 2] = 0.8
    planes["A"][2, 2] = 0
    write(path, planes)


def test_colour_without_coverage_survives_in_the_plate(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", background={"path": "background.exr"})
    write(folder / "background.exr", rgba(0.1, np.ones((HEIGHT, WIDTH))))
    write_glow(folder / PLATE, rgba(0.5, SPHERE.matte))
    assert finished(deliver(folder)).at(2, 2, "") == pytest.approx([0.9] * 3, abs=2e-3)


def test_colour_without_coverage_survives_in_the_background(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", background={"path": "background.exr"})
    write_glow(folder / "background.exr", rgba(0.1, np.ones((HEIGHT, WIDTH))))
    outcome = finished(deliver(folder))
    assert (*outcome.at(2, 2, ""), float(outcome.planes["A"][2, 2])) == pytest.approx((0.8, 0.8, 0.8, 0), abs=2e-3)


def test_nan_normals_outside_the_matte_stop_nothing(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    normal = np.where(SPHERE.hit[..., None], SPHERE.normal, np.nan)
    write(folder / GBUFFER, gbuffer(SPHERE, normal))
    assert finished(deliver(folder)).centre() == pytest.approx([0.5] * 3, abs=2e-3)


def test_an_infinite_light_is_clamped_where_the_job_says_so(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", light={"path": "light.exr", "clamp": 100})
    light = stored(folder / "light.exr")
    for name in "RGB":
        light[name][7, 5] = np.inf
    write(folder / "light.exr", light)
    assert np.isfinite(finished(deliver(folder)).centre()).all()


def test_a_rotation_may_be_given_by_frame(tmp_path: Path) -> None:
    light = np.ones((16, 32, 3), np.float32)
    light[:, 16:] = 0.1
    red = {}
    turns = {"fixed": [90, 0, 0], "by frame": {FRAME: [90, 0, 0], FRAME + 1: [180, 0, 0]}}
    for name, rotation in turns.items():
        folder = write_shot(tmp_path / name, (FRAME, FRAME + 1), light={"path": "light.exr", "rotation": rotation})
        write(folder / "light.exr", sky(light))
        red[name] = finished(deliver(folder)).planes["relit.R"]
    np.testing.assert_array_equal(red["by frame"], red["fixed"])
