"""EXRs of awkward kinds: each is read right, or refused in one clear paragraph; uninitialised memory never."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from tests.io.exr_bytes import Raw, string_vector, write_raw, write_tiled
from yesnt.core.errors import JobError
from yesnt.core.shot import PlateInput
from yesnt.core.windows import Window, place
from yesnt.io.pictures.image import read_channels, read_headers
from yesnt.io.pictures.passes import find_color
from yesnt.io.pictures.plate_header import read_plate_header

SIDE = 8
RAMP = np.linspace(0.25, 1, SIDE * SIDE).reshape(SIDE, SIDE).astype(np.float32)
HALF = RAMP.astype(np.float16)
GREY = dict.fromkeys("RGB", HALF)
FULL = GREY | {"A": np.ones((SIDE, SIDE), np.float16)}
SMALL = HALF[:4, :4]
DISPLAY = (0, 0, SIDE - 1, SIDE - 1)

Array = np.ndarray[Any, Any]
Write = Callable[[Path], None]


def raw(*parts: Raw) -> Write:
    return lambda path: write_raw(path, *parts)


def grey(**keys: Any) -> Write:
    """One part of R, G, B, A with other attributes of the file."""
    return raw(Raw(FULL, **keys))


def compressed(name: str) -> Write:
    def write(path: Path) -> None:
        header = {"compression": getattr(OpenEXR, f"{name}_COMPRESSION"), "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, dict(FULL)) as target:
            target.write(str(path))

    return write


def deep_tiles(path: Path) -> None:
    spec = oiio.ImageSpec(SIDE, SIDE, 4, oiio.FLOAT)
    spec.channelnames, spec.deep, spec.tile_width, spec.tile_height = tuple("RGBA"), True, 4, 4
    data = oiio.DeepData()
    data.init(SIDE * SIDE, 4, [oiio.TypeFloat] * 4, list("RGBA"))
    for pixel in range(SIDE * SIDE):
        data.set_samples(pixel, 1)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec)
    assert target.write_deep_tiles(0, SIDE, 0, SIDE, 0, 1, data)
    target.close()


DEEP_PART = raw(Raw({"Z": RAMP}, name="part0"), Raw(FULL, name="part1", deep=True))


def cut(write: Write, keep: float) -> Write:
    """The file's first part only."""

    def shortened(path: Path) -> None:
        write(path)
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * keep)])

    return shortened


def header_only(path: Path) -> None:
    write_raw(path, Raw(FULL))
    path.write_bytes(path.read_bytes()[: -SIDE * (8 + SIDE * 8)])


def floats(*values: float) -> tuple[str, bytes]:
    return "chromaticities", struct.pack(f"<{len(values)}f", *values)


AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290)
ODD = np.array([[np.inf, np.nan], [6e-8, -np.inf]], np.float16)
WIDE = np.linspace(0, 1, 16384).astype(np.float16)[None]

COMPRESSIONS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB", "ZSTD", "HTJ2K32")

READ: dict[str, tuple[Write, Array]] = {
    "negative origin": (grey(data=(-2, -1, 5, 6), display=DISPLAY), RAMP),
    "display smaller than data": (grey(display=(2, 2, 5, 5)), RAMP),
    "display larger than data": (grey(display=(-4, -4, 20, 20)), RAMP),
    "1x1": (raw(Raw({c: HALF[:1, :1] for c in "RGB"})), RAMP[:1, :1]),
    "1xN": (raw(Raw({c: HALF[:, :1] for c in "RGB"})), RAMP[:, :1]),
    "Nx1": (raw(Raw({c: HALF[:1] for c in "RGB"})), RAMP[:1]),
    "decreasing Y": (grey(order="decreasing"), RAMP),
    "random Y": (grey(order="random"), RAMP),
    "tiles": (lambda p: write_tiled(p, RAMP, 4), RAMP),
    "mipmap": (lambda p: write_tiled(p, RAMP, 4, "mip"), RAMP),
    "ripmap": (lambda p: write_tiled(p, RAMP, 4, "rip"), RAMP),
    "parts of one window": (raw(Raw({"Z": RAMP}, name="depth"), Raw(FULL, name="rgba")), RAMP),
    "parts of several windows": (
        raw(Raw({"Z": RAMP[:4]}, data=(0, 2, 7, 5), display=DISPLAY, name="depth"), Raw(FULL, name="rgba")), RAMP,
    ),
    "a deep part beside it": (raw(Raw(FULL, name="rgba"), Raw({"Z": RAMP}, name="depth", deep=True)), RAMP),
    "half, float and uint": (raw(Raw(FULL | {"Z": RAMP, "id": RAMP.astype(np.uint32)})), RAMP),
    "only Y": (raw(Raw({"Y": HALF})), RAMP),
    "RGB without A": (raw(Raw(GREY)), RAMP),
    "lower case": (raw(Raw({c.lower(): HALF for c in "RGBA"})), RAMP),
    "rgba.red": (raw(Raw({f"rgba.{c}": HALF for c in ("red", "green", "blue", "alpha")})), RAMP),
    "names with blanks": (raw(Raw({f"my layer.{c}": HALF for c in "RGB"})), RAMP),
    "names of four dots": (raw(Raw({f"a.b.c.d.{c}": HALF for c in "RGB"})), RAMP),
    "200 channels": (raw(Raw(FULL | {f"aov{i:03}.V": HALF for i in range(196)})), RAMP),
    "long names": (raw(Raw({f"{'x' * 200}.{c}": HALF for c in "RGB"})), RAMP),
    **{f"compression {name}": (compressed(name), RAMP) for name in COMPRESSIONS},
    "chromaticities AP0": (grey(attributes={"chromaticities": floats(*AP0)}), RAMP),
    "chromaticities AP1": (grey(attributes={"chromaticities": floats(*AP1)}), RAMP),
    "chromaticities P3": (grey(attributes={"chromaticities": floats(*P3)}), RAMP),
    "chromaticities of nonsense": (grey(attributes={"chromaticities": floats(*[0.0] * 8)}), RAMP),
    "aspect 0.5": (grey(aspect=0.5), RAMP),
    "aspect 2": (grey(aspect=2.0), RAMP),
    "huge attributes": (grey(attributes={"notes": ("string", b"x" * (1 << 20))}), RAMP),
    "unknown attribute": (grey(attributes={"mine": ("mytype", b"abc")}), RAMP),
    "Inf, NaN, denormals": (raw(Raw({c: ODD for c in "RGB"})), ODD.astype(np.float32)),
    "16k wide": (raw(Raw({c: WIDE for c in "RGB"})), WIDE.astype(np.float32)),
}  # fmt: skip

IN_FLOAT = {"tiles", "mipmap", "ripmap"}

LOSSY = {"B44": 0.02, "B44A": 0.02, "DWAA": 0.03, "DWAB": 0.03}
"""Relative errors that these compressions make by design."""


def read_color(path: Path) -> dict[str, Array]:
    """Red, green and blue as stored."""
    found = find_color(read_headers(path), PlateInput(path="x.exr"), "plate").color
    return {c.name: read_channels(c.header, [c.name])[c.name] for c in found}


@pytest.mark.parametrize("name", READ)
def test_it_is_read_right(tmp_path: Path, name: str) -> None:
    write, expected = READ[name]
    path = tmp_path / "x.exr"
    write(path)
    planes = read_color(path)
    tolerance = LOSSY.get(name.rpartition(" ")[2], 0)
    for plane in planes.values():
        assert plane.dtype == np.float32
        assert plane.flags.c_contiguous
        stored = (
            expected
            if plane.dtype == expected.dtype and np.array_equal(plane, expected)
            else expected.astype(np.float16)
        )
        np.testing.assert_allclose(plane, stored.astype(np.float32), rtol=tolerance)


CHROMA = raw(Raw({"Y": HALF, "RY": SMALL, "BY": SMALL}, sampling={"RY": (2, 2), "BY": (2, 2)}))

REFUSED: dict[str, tuple[Write, str]] = {
    "empty data window": (raw(Raw(GREY, data=(0, 0, -1, -1), display=DISPLAY)), "cannot be opened.*data window"),
    "deep scan lines": (raw(Raw(FULL, deep=True)), "The picture is deep: a pixel holds many samples.*DeepToImage"),
    "deep tiles": (deep_tiles, "The picture is deep"),
    "a deep part": (DEEP_PART, "The picture in part part1 is deep"),
    "luminance and chroma": (CHROMA, "lower resolution, as luminance-chroma EXRs have.*export it as RGB"),
    "subsampled": (raw(Raw(GREY | {"B": SMALL}, sampling={"B": (2, 2)})), "channels of lower resolution"),
    "only A": (raw(Raw({"A": HALF})), "No channels of the picture are the plate's red, green and blue"),
    "no channels": (raw(Raw({}, data=DISPLAY)), "cannot be opened.*channel"),
    "views without a choice": (
        raw(Raw(GREY | {f"left.{c}": HALF for c in "RGB"}, attributes={"multiView": string_vector("right", "left")})),
        "has the views left, right",
    ),
    "aspect 0": (grey(aspect=0.0), "cannot be opened.*pixel aspect ratio 0"),
    "aspect NaN": (grey(aspect=float("nan")), "cannot be opened.*pixel aspect ratio"),
    "cut short": (cut(grey(), 0.7), "damaged or cut short"),
    "cut in the header": (cut(grey(), 0.05), "cannot be opened"),
    "header only": (header_only, "damaged or cut short"),
    "missing tiles": (lambda p: write_tiled(p, RAMP, 4, missing=2), "damaged or cut short.*missing or corrupted"),
    "missing tiles of a mipmap": (lambda p: write_tiled(p, RAMP, 4, "mip", missing=5), "damaged or cut short"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_in_one_paragraph(tmp_path: Path, name: str) -> None:
    write, message = REFUSED[name]
    path = tmp_path / "x.exr"
    write(path)
    with pytest.raises(JobError, match=message) as caught:
        read_color(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    assert caught.value.do


def test_forty_kinds_are_tried() -> None:
    assert len(READ) + len(REFUSED) >= 40


@pytest.mark.parametrize("fast", [True, False])
def test_integers_are_as_stored(tmp_path: Path, fast: bool) -> None:
    values = np.array([[0, 1], [255, 70000]], np.uint32)
    write_raw(tmp_path / "x.exr", Raw({"A": values} | ({} if fast else {f"b{i}": values for i in range(9)})))
    np.testing.assert_array_equal(read_channels(read_headers(tmp_path / "x.exr")[0], ["A"])["A"], values)


def test_deep_and_flat_parts_of_one_file(tmp_path: Path) -> None:
    DEEP_PART(tmp_path / "x.exr")
    np.testing.assert_array_equal(read_channels(read_headers(tmp_path / "x.exr")[0], ["Z"])["Z"], RAMP)


def test_what_is_read_does_not_depend_on_leftovers_of_memory(tmp_path: Path) -> None:
    """Missing pixels are refused with memory full of a value that would be seen."""
    write_tiled(tmp_path / "x.exr", RAMP, 4, missing=1)
    for _ in range(3):
        leftovers = [np.full((SIDE, SIDE, 3), 7777, np.float32) for _ in range(200)]
        del leftovers
        with pytest.raises(JobError, match="damaged or cut short"):
            read_channels(read_headers(tmp_path / "x.exr")[0], ["R", "G", "B"])


@pytest.mark.parametrize(
    ("rate", "expected"),
    [((24000, 1001), (24000, 1001)), ((25, 1), (25, 1)), ((0, 1), None), ((1, 0), None), ((2000, 1), None)],
)
def test_a_frame_rate_is_one_that_a_video_can_have(
    tmp_path: Path, rate: tuple[int, int], expected: tuple[int, int] | None
) -> None:
    stored = {"framesPerSecond": ("rational", struct.pack("<iI", *rate))}
    grey(attributes=stored)(tmp_path / "x.exr")
    assert read_plate_header(tmp_path / "x.exr", PlateInput(path="x.exr")).rate == expected


def test_windows_are_placed() -> None:
    plane = np.arange(12, dtype=np.float32).reshape(3, 4)
    stored = Window(-1, 1, 4, 3)
    np.testing.assert_array_equal(place(plane, stored, stored), plane)
    np.testing.assert_array_equal(place(plane, stored, Window(0, 0, 2, 3)), [[0, 0], [1, 2], [5, 6]])
    assert not place(plane, stored, Window(10, 10, 2, 2)).any(), "windows that do not meet"
