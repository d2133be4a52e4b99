"""Colour spaces, alpha and clamps: the right value, or a line that says what was done."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cases.shots import (
    ACES_AP1,
    ACESCG_COLOR,
    FRAME,
    HEIGHT,
    REC709_COLOR,
    WIDTH,
    Outcome,
    check,
    deliver,
    rgba,
    sky,
    sphere,
    write,
    write_shot,
)
from yesnt.core.errors import JobError
from yesnt.io.shot_inputs import read_plate
from yesnt.runtime.session import Session

SPHERE = sphere()
PLATE = f"plate.{FRAME}.exr"
HALF = np.round(SPHERE.matte * 128).astype(np.uint8)
"""Coverage .5 in 8 bits."""


def plate_centre(folder: Path) -> tuple[float, float]:
    """Straight red and coverage of the plate at the middle of the picture, as the product reads it."""
    try:
        plate = read_plate(Session(folder).job, FRAME)
    except JobError as refused:
        raise AssertionError(f"the plate is refused: {refused}") from refused
    return float(plate.color[HEIGHT // 2, WIDTH // 2, 0]), float(plate.matte[HEIGHT // 2, WIDTH // 2])


def says(outcome: Outcome, *words: str) -> bool:
    """Whether refusal or warnings hold one of the words."""
    told = " ".join((outcome.refusal, *outcome.warnings)).lower()
    return any(word in told for word in words)


@pytest.fixture
def converted(tmp_path: Path) -> list[float]:
    """The relit colour of a plate that was converted to linear Rec.709 before.

    Its green is not the plate's: the surface reflects more than the plate's green, which is below 0 in Rec.709.
    """
    folder = write_shot(tmp_path / "converted")
    write(folder / PLATE, rgba(np.array(REC709_COLOR), SPHERE.matte))
    return deliver(folder).centre()


def test_a_plate_in_acescg_is_converted_and_that_is_reported(tmp_path: Path, converted: list[float]) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(np.array(ACESCG_COLOR), SPHERE.matte), chromaticities=ACES_AP1)
    outcome = deliver(folder)
    assert says(outcome, "plate: read as acescg, as its files say (chromaticities 0.713, 0.293")
    assert outcome.centre() == pytest.approx(converted, abs=1e-3)
    assert outcome.centre()[::2] == pytest.approx(REC709_COLOR[::2], abs=1e-3)


def test_a_light_in_acescg_is_converted_or_refused(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / "light.exr", sky(np.array(ACESCG_COLOR)), chromaticities=ACES_AP1)
    outcome = deliver(folder)
    refused = "chromaticities" in outcome.refusal
    assert refused or outcome.at(0, 0, "") == pytest.approx(REC709_COLOR, abs=0.02)


def test_acescg_may_be_named_in_the_job(tmp_path: Path, converted: list[float]) -> None:
    folder = write_shot(tmp_path / "s", plate={"path": "plate.####.exr", "colorspace": "acescg"})
    write(folder / PLATE, rgba(np.array(ACESCG_COLOR), SPHERE.matte))
    outcome = deliver(folder)
    assert outcome.refusal == ""
    assert outcome.centre() == pytest.approx(converted, abs=1e-3)


def write_png(folder: Path, value: int, alpha: np.ndarray | None) -> None:
    """An 8-bit PNG of one grey inside the sphere."""
    planes = [np.where(SPHERE.hit, value, 0).astype(np.uint8)] * 3 + ([] if alpha is None else [alpha])
    cv2.imwrite(str(folder / f"plate.{FRAME}.png"), np.dstack(planes))


@pytest.mark.parametrize("alpha", [HALF, HALF * 2 - SPHERE.hit], ids=["half", "whole"])
def test_a_png_without_colour_space_is_srgb_and_that_is_reported(tmp_path: Path, alpha: np.ndarray) -> None:
    folder = write_shot(tmp_path / "s", plate={"path": "plate.####.png"})
    write_png(folder, 188, alpha)
    assert plate_centre(folder)[0] == pytest.approx(0.503, abs=2e-3)
    assert says(check(folder), "srgb")


def test_a_matte_may_have_a_file_of_its_own(tmp_path: Path) -> None:
    plate = {"path": "plate.####.png", "colorspace": "srgb"}
    folder = write_shot(tmp_path / "s", plate=plate, matte={"path": "matte.####.png"})
    write_png(folder, 188, None)
    cv2.imwrite(str(folder / f"matte.{FRAME}.png"), (SPHERE.matte * 65535).astype(np.uint16))
    outcome = deliver(folder)
    assert outcome.refusal == ""
    np.testing.assert_array_equal(outcome.planes["relit.A"], SPHERE.matte)
    assert outcome.centre() == pytest.approx([0.503] * 3, abs=5e-3)


def test_a_plate_on_black_that_was_multiplied_before_encoding(tmp_path: Path) -> None:
    """What Blender writes as RGB on black, and Nuke as 8 bits; the matte is a file of its own."""
    plate = {"path": "plate.####.png", "colorspace": "srgb", "alpha": "premultiplied_linear"}
    folder = write_shot(tmp_path / "s", plate=plate, matte={"path": "matte.####.png"})
    write_png(folder, 137, None)  # sRGB of 0.25, which is 0.5 at half coverage
    cv2.imwrite(str(folder / f"matte.{FRAME}.png"), HALF)
    assert plate_centre(folder) == pytest.approx((0.5, 0.502), abs=5e-3)


def test_a_tiff_whose_alpha_was_associated_after_encoding(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", plate={"path": "plate.####.tif", "colorspace": "srgb"})
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 4, oiio.UINT8)
    spec.channelnames, spec.alpha_channel = tuple("RGBA"), 3
    path = str(folder / f"plate.{FRAME}.tif")
    target = oiio.ImageOutput.create(path)
    target.open(path, spec)
    target.write_image(np.dstack([np.where(SPHERE.hit, 94, 0).astype(np.uint8)] * 3 + [HALF]))
    target.close()
    assert plate_centre(folder) == pytest.approx((0.503, 0.502), abs=5e-3)


def test_an_exr_in_srgb_whose_alpha_was_associated_after_encoding(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", plate={"path": "plate.####.exr", "colorspace": "srgb"})
    write(folder / PLATE, rgba(0.5, SPHERE.matte / 2))
    assert plate_centre(folder) == pytest.approx((0.214, 0.5), abs=2e-3)


def test_an_alpha_of_127_is_half_or_reported(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(0.25, SPHERE.matte) | {"A": 127 * SPHERE.matte})
    assert says(check(folder), "alpha") or plate_centre(folder) == pytest.approx((0.5, 0.498), abs=2e-3)


def test_an_integer_alpha_of_1_covers_the_pixel(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(0.5, SPHERE.matte) | {"A": SPHERE.hit.astype(np.uint32)})
    assert plate_centre(folder) == pytest.approx((0.5, 1.0), abs=2e-3)


def test_a_plate_without_alpha_is_reported_as_that(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    planes = rgba(0.5, SPHERE.matte)
    write(folder / PLATE, {name: planes[name] + 0.1 for name in "RGB"})
    assert says(check(folder), "alpha")


def test_an_8_bit_light_map_is_decoded_or_refused(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", light={"path": "light.png"})
    oiio.ImageBuf(np.full((16, 32, 3), 0.5, np.float32)).write(str(folder / "light.png"), "uint8")
    outcome = deliver(folder)
    assert outcome.refusal or outcome.at(0, 0, "") == pytest.approx([0.214] * 3, abs=3e-3)


@pytest.mark.parametrize("value", [0.1, 0.5])
def test_the_same_light_in_and_out_gives_the_plate(tmp_path: Path, value: float) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(value, SPHERE.matte))
    assert deliver(folder).centre() == pytest.approx([value] * 3, rel=2e-3)


@pytest.mark.parametrize("value", [2.0, 20.0])
def test_a_base_colour_above_1_survives_or_is_counted(tmp_path: Path, value: float) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(value, SPHERE.matte))
    outcome = deliver(folder)
    assert outcome.reported or outcome.centre() == pytest.approx([value] * 3, rel=2e-3)


def test_a_base_colour_that_no_surface_can_have_is_counted(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(0.02, SPHERE.matte))  # less than what the surface reflects without any base colour
    outcome = deliver(folder)
    assert outcome.reported or outcome.centre() == pytest.approx([0.02] * 3, rel=2e-3)


def test_results_above_the_range_of_half_are_counted(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", light={"path": "light.exr", "exposure": 10.0})
    write(folder / "light.exr", sky(60000.0))
    assert says(deliver(folder), "65504")
