import numpy as np
import pytest

from yesnt.capture_stage import passes as post_process
from yesnt.capture_stage.package import round_mantissa
from yesnt.core.errors import CorruptError


@pytest.fixture
def passes():
    """4x4: the centres of the left half hit at z = 2; the third column is covered by a quarter."""
    hit = np.zeros((4, 4), dtype=np.float32)
    hit[:, :2] = 1
    cover = hit.copy()
    cover[:, 2] = 0.25
    points = {
        "Depth.Z": np.where(hit > 0, np.float32(2.0), np.float32(1e10)),
        "Normal.X": 0.6 * hit, "Normal.Y": 0 * hit, "Normal.Z": -0.8 * hit,
        "Vector.Z": -3 * hit, "Vector.W": 1.5 * hit,
    }  # fmt: skip
    lit = {"Combined.A": cover, **{f"Combined.{c}": 0.5 * cover - 0.01 * (1 - cover) for c in "RGB"}}
    return points, lit


def test_partly_covered_pixels_take_geometry_from_the_nearest_hit(passes):
    surface = post_process.geometry(*passes)
    assert (surface["depth.Z"][:, :3] == 2).all()
    assert (surface["depth.Z"][:, 3] > 1e9).all()
    length = np.sqrt(sum(surface[f"N.{c}"].astype(float) ** 2 for c in "XYZ"))
    assert np.allclose(length[:, :3], 1, atol=1e-3)
    assert (length[:, 3] == 0).all()


def test_flow_is_right_and_down(passes):
    moved = post_process.flow(*passes)
    assert (moved["forward.u"][:, :3] == 3).all()
    assert (moved["forward.v"][:, :3] == 1.5).all()
    assert (moved["forward.u"][:, 3] == 0).all()


def test_pictures_hold_no_negative_light(passes):
    picture = post_process.picture(passes[1])
    assert all(plane.dtype == np.float16 and plane.min() >= 0 for plane in picture.values())


def test_an_empty_picture_has_no_geometry(passes):
    points, lit = passes
    empty = {**points, "Depth.Z": np.full((4, 4), 1e10, dtype=np.float32)}
    assert (post_process.geometry(empty, lit)["depth.Z"] > 1e9).all()


@pytest.mark.parametrize(("dtype", "bits"), [(np.float32, 13), (np.float16, 8)])
def test_rounding_keeps_what_it_promises(dtype, bits):
    plane = np.linspace(0.01, 9, 1000).astype(dtype).reshape(10, 100)
    rounded = round_mantissa(plane, bits)
    assert rounded.dtype == dtype
    assert np.abs(rounded.astype(float) / plane.astype(float) - 1).max() <= 2.0 ** -(bits + 1)
    assert (round_mantissa(np.zeros((2, 2), dtype), bits) == 0).all()


def test_damaged_raw_pictures_are_told(tmp_path):
    (tmp_path / "raw.exr").write_bytes(b"\x76\x2f\x31\x01 and then nothing")
    with pytest.raises(CorruptError, match="does not decode"):
        post_process.read_passes(tmp_path / "raw.exr")
