"""PNG, TIFF, JPEG and DPX of 8, 10 and 16 bits: values, alpha as the format has it, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cases.shots import FRAME, check, sphere, write_shot
from yesnt.core.errors import JobError
from yesnt.core.shot import PlateInput
from yesnt.io.pictures.association import association
from yesnt.io.pictures.image import read_channels, read_headers
from yesnt.io.pictures.passes import find_color
from yesnt.io.pictures.placed import check_fits
from yesnt.io.pictures.plate_header import read_plate_header
from yesnt.io.shot_inputs import read_plate
from yesnt.runtime.session import Session

KINDS = {8: oiio.UINT8, 10: oiio.UINT16, 16: oiio.UINT16, 32: oiio.FLOAT}


def write(path: Path, bits: int, pixels: np.ndarray, **attributes: Any) -> Path:
    """A picture [H, W, C], integers as they are or numbers in [0, 1]."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, KINDS[bits])
    spec.channelnames = tuple({1: "Y", 2: "YA"}.get(channels, "RGBA"[:channels]))
    spec.alpha_channel = channels - 1 if channels in (2, 4) else -1
    spec.attribute("oiio:BitsPerSample", bits)
    spec.attribute("oiio:UnassociatedAlpha", 1)  # the writer multiplies nothing
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec)
    assert target.write_image(pixels if pixels.dtype.kind == "u" else pixels.astype(np.float32))
    target.close()
    return path


RAMP = np.linspace(0, 1, 32 * 8 * 3).reshape(8, 32, 3)


@pytest.mark.parametrize(
    ("name", "bits"), [("png", 8), ("png", 16), ("tif", 8), ("tif", 16), ("dpx", 8), ("dpx", 10), ("dpx", 16)]
)
def test_integers_of_all_depths_are_exact(tmp_path: Path, name: str, bits: int) -> None:
    codes = np.linspace(0, 2**bits - 1, 32 * 8 * 3).astype(np.uint16).reshape(8, 32, 3)
    stored = codes.astype(np.uint8) if bits == 8 else codes << 6 | codes >> 4 if bits == 10 else codes
    planes = read_channels(read_headers(write(tmp_path / f"x.{name}", bits, stored))[0], ["R", "G", "B"])
    rounding = 1 / 65535 if bits == 10 else 1e-7  # 10 bits are held in 16
    np.testing.assert_allclose(np.stack([planes[c] for c in "RGB"], -1), codes / (2**bits - 1), atol=rounding)


def test_floats_are_exact(tmp_path: Path) -> None:
    planes = read_channels(read_headers(write(tmp_path / "x.tif", 32, 100 * RAMP - 5))[0], ["R", "G", "B"])
    np.testing.assert_array_equal(np.stack([planes[c] for c in "RGB"], -1), (100 * RAMP - 5).astype(np.float32))


def test_a_jpeg_is_read_within_its_loss(tmp_path: Path) -> None:
    path = write(tmp_path / "x.jpg", 8, np.repeat(RAMP[..., :1], 3, -1), CompressionQuality=100)
    planes = read_channels(read_headers(path)[0], ["R"])
    np.testing.assert_allclose(planes["R"], RAMP[..., 0], atol=0.02)


@pytest.mark.parametrize(
    ("name", "straight", "said", "expected"),
    [
        ("png", True, None, "straight"),
        ("png", True, "premultiplied", "premultiplied"),
        ("tif", True, None, "straight"),
        ("tif", False, None, "premultiplied"),
        ("tif", False, "straight", "straight"),
        ("dpx", False, None, "premultiplied"),
    ],
)
def test_alpha_is_as_the_format_or_the_job_says(
    tmp_path: Path, name: str, straight: bool, said: str | None, expected: str
) -> None:
    path = write(tmp_path / f"x.{name}", 16, np.full((8, 32, 4), 0.25), oiio__UnassociatedAlpha=int(straight))
    spec = PlateInput.model_validate({"path": str(path), "alpha": said})
    assert association(find_color(read_headers(path), spec, "plate"), spec) == expected


def test_exr_is_premultiplied_and_a_picture_without_alpha_straight(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    spec = PlateInput(path="x")
    assert association(find_color(read_headers(folder / f"plate.{FRAME}.exr"), spec, "plate"), spec) == "premultiplied"
    path = write(tmp_path / "x.png", 8, RAMP)
    assert association(find_color(read_headers(path), spec, "plate"), spec) == "straight"


@pytest.mark.parametrize(("said", "expected"), [(None, 0.5), ("premultiplied", 1.0)])
def test_stated_alpha_acts(tmp_path: Path, said: str | None, expected: float) -> None:
    plate = {"path": "plate.####.tif", "colorspace": "lin_rec709"} | ({"alpha": said} if said else {})
    folder, matte = write_shot(tmp_path / "s", plate=plate), sphere().matte
    pixels = np.dstack([0.5 * matte] * 3 + [0.5 * matte])
    write(folder / f"plate.{FRAME}.tif", 32, pixels)
    seen = read_plate(Session(folder).job, FRAME)
    assert seen.color[24, 32].tolist() == [expected] * 3
    assert seen.matte[24, 32] == 0.5


def test_alpha_of_a_format_that_does_not_say_is_reported(tmp_path: Path) -> None:
    folder, matte = write_shot(tmp_path / "s", plate={"path": "plate.####.dpx"}), sphere().matte
    write(folder / f"plate.{FRAME}.dpx", 16, np.dstack([matte] * 4), oiio__UnassociatedAlpha=0)
    told = " ".join(check(folder).warnings)
    assert "plate: dpx does not say whether colour is multiplied by alpha; it is read as premultiplied" in told
    folder = write_shot(tmp_path / "t", plate={"path": "../s/plate.####.dpx", "alpha": "straight"})
    assert "does not say whether" not in " ".join(check(folder).warnings)


def test_a_picture_that_is_stored_turned_is_refused(tmp_path: Path) -> None:
    job = Session(write_shot(tmp_path / "s", size=(32, 8))).job
    check_fits(job, read_headers(write(tmp_path / "upright.jpg", 8, RAMP))[0])
    turned = read_headers(write(tmp_path / "turned.jpg", 8, RAMP, Orientation=6))[0]
    with pytest.raises(JobError, match=r"stored turned \(its attribute Orientation is 6\).*turned\.jpg"):
        check_fits(job, turned)


def test_the_pixel_aspect_ratio_of_other_formats_counts(tmp_path: Path) -> None:
    path = write(tmp_path / "x.tif", 16, RAMP, PixelAspectRatio=2.0)
    assert read_plate_header(path, PlateInput(path="x")).aspect == 2.0


@pytest.mark.parametrize("equal", [True, False])
def test_a_matte_of_three_channels_must_be_grey(tmp_path: Path, equal: bool) -> None:
    folder, matte = write_shot(tmp_path / "s", matte={"path": "matte.####.png"}), sphere().matte
    pixels = np.dstack([matte] * 3)
    pixels[24, 32, 2] = 1 if equal else 0
    write(folder / f"matte.{FRAME}.png", 8, pixels)
    if equal:
        np.testing.assert_array_equal(read_plate(Session(folder).job, FRAME).matte, matte)
    else:
        assert "The red, green and blue of the matte differ" in check(folder).refusal


def test_a_matte_replaces_the_alpha_and_colour_stays_straight(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", matte={"path": "matte.####.png"})
    left = np.zeros((48, 64))
    left[:, :32] = 1
    write(folder / f"matte.{FRAME}.png", 8, left[..., None])
    seen = read_plate(Session(folder).job, FRAME)
    np.testing.assert_array_equal(seen.matte, left)
    inside = (sphere().matte > 0) & (left > 0)
    np.testing.assert_allclose(seen.color[inside], 0.5, atol=1e-6)


def test_a_changed_matte_changes_what_depends_on_it(tmp_path: Path) -> None:
    keys = []
    for value in (1.0, 0.5):
        folder = write_shot(tmp_path / str(value), matte={"path": "matte.####.png"})
        write(folder / f"matte.{FRAME}.png", 8, value * sphere().matte[..., None])
        keys.append({node.stage.label: node.key for node in Session(folder).graph()})
    assert not {stage for stage in keys[0] if keys[0][stage] == keys[1][stage]}
