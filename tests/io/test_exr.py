import struct
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from yesnt.core.errors import JobError
from yesnt.io.exr import EXR_COMPRESSIONS, write_exr
from yesnt.io.pictures import image as reader
from yesnt.io.pictures.image import read_header, read_image

PLANES = {
    "R": np.linspace(0, 2, 12, dtype=np.float16).reshape(3, 4),
    "roughness.Y": np.linspace(0, 1, 12, dtype=np.float16).reshape(3, 4),
    "depth.Z": np.linspace(1, 9, 12, dtype=np.float32).reshape(3, 4),
}


@pytest.mark.parametrize("compression", EXR_COMPRESSIONS)
def test_round_trip_is_exact_and_bytes_repeat(tmp_path: Path, compression: str) -> None:
    one, two = tmp_path / "one.exr", tmp_path / "two.exr"
    for path in (one, two):
        write_exr(path, PLANES, {"yesnt:job": "abc"}, compression)
    image = read_image(one)
    for name, plane in PLANES.items():
        np.testing.assert_array_equal(image.channels[name], plane.astype(np.float32))
    assert image.header.attributes["yesnt:job"] == "abc"
    assert image.header.attributes["compression"] == compression
    assert one.read_bytes() == two.read_bytes()


def test_unknown_compression_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="compression='dwaa' must be one of"):
        write_exr(tmp_path / "x.exr", PLANES, compression="dwaa")
    assert not list(tmp_path.iterdir())


def _foreign(path: Path, tile: int, kind: str, parts: int = 1) -> np.ndarray:
    """What another program might write: tiled, with integer channels, or in several parts."""
    pixels = np.arange(16 * 16 * 2, dtype=np.float32).reshape(16, 16, 2) / 512
    spec = oiio.ImageSpec(16, 16, 2, kind)
    spec.channelnames, spec.tile_width, spec.tile_height = ("A", "Z"), tile, tile
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), (spec,) * parts)
    for part in range(parts):
        assert not part or output.open(str(path), spec, "AppendSubimage")
        given = np.full_like(pixels, 9) if part else pixels
        assert output.write_image((given * 512).astype(np.uint32) if kind == "uint" else given)
    output.close()
    return pixels


@pytest.mark.parametrize(
    ("tile", "kind", "parts", "plain"),
    [(0, "half", 1, True), (0, "float", 1, True), (8, "half", 1, False), (0, "uint", 1, False), (0, "half", 2, False)],
)
def test_both_readers_see_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tile: int, kind: str, parts: int, plain: bool
) -> None:
    pixels, used = _foreign(tmp_path / "x.exr", tile, kind, parts), []
    fast = reader.read_planes
    monkeypatch.setattr(reader, "read_planes", lambda path: used.append(path) or fast(path))
    image = read_image(tmp_path / "x.exr")
    assert bool(used) == plain
    if kind != "uint":  # OpenImageIO scales integers to 0 .. 1
        for name, plane in zip("AZ", np.moveaxis(pixels, -1, 0), strict=True):
            np.testing.assert_array_equal(image.channels[name], plane.astype(kind.replace("half", "float16")))
    assert all(plane.dtype == np.float32 and plane.flags.c_contiguous for plane in image.channels.values())


def test_truncated_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.exr"
    noise = np.random.default_rng(0).random((64, 64)).astype(np.float32)
    write_exr(path, {"R": noise})
    path.write_bytes(path.read_bytes()[:9000])
    with pytest.raises(JobError, match=r"damaged or cut short.*Expected: 64x64 pixels"):
        read_image(path)


def test_absurd_header_is_refused_without_memory(tmp_path: Path) -> None:
    path = tmp_path / "x.exr"
    write_exr(path, PLANES)
    data = bytearray(path.read_bytes())
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(name) + len(name) + 4
        data[at : at + 16] = struct.pack("<4i", 0, 0, 999_999, 999_999)
    path.write_bytes(data)
    for read in (read_header, read_image):
        with pytest.raises(JobError, match=r"1000000x1000000|cannot be opened"):
            read(path)


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.exr"
    path.write_text("no picture")
    with pytest.raises(JobError, match="cannot be opened"):
        read_image(path)
    with pytest.raises(JobError, match="missing"):
        read_image(tmp_path / "absent.exr")


def test_absent_channel_names_what_is_there(tmp_path: Path) -> None:
    path = tmp_path / "x.exr"
    write_exr(path, PLANES)
    with pytest.raises(JobError, match=r"no channel N\.X.*it has R"):
        read_image(path).stack(["N.X"])


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r".+"):
        write_exr(tmp_path / "x.exr", {"R": np.zeros((2, 2), np.float16), "G": np.zeros((3, 3), np.float16)})
    assert not list(tmp_path.iterdir())
