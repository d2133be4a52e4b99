"""OpenColorIO: names, roles, near names, tables, and what a digest says."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from yesnt.core.color import srgb_decode, srgb_encode
from yesnt.core.color_spaces import ACESCG, LIN_REC709, SRGB, Conversion
from yesnt.core.errors import JobError
from yesnt.io.color_config import BUILT_IN, ColorConfig, convert, fresh_config, locate_config, open_config

COLORS = np.array([[0.5, 0.05, 0.05], [0.18, 0.18, 0.18], [0, 1, 4]], np.float32)

CONFIG = """ocio_profile_version: 2
search_path: luts
roles: {scene_linear: mine, default: mine, aces_interchange: ap0}
displays: {Monitor: [!<View> {name: Film, colorspace: shown}]}
active_displays: []
active_views: []
colorspaces:
  - !<ColorSpace> {name: ap0}
  - !<ColorSpace>
    name: mine
    to_scene_reference: !<MatrixTransform>
      matrix: [0.6954522414, 0.1406786965, 0.1638690622, 0, 0.0447945634, 0.8596711185, 0.0955343182, 0,
               -0.0055258826, 0.0040252103, 1.0015006723, 0, 0, 0, 0, 1]
  - !<ColorSpace> {name: camera log, aliases: [camlog], to_scene_reference: !<FileTransform> {src: camera.spi1d}}
  - !<ColorSpace> {name: shown, from_scene_reference: !<FileTransform> {src: camera.spi1d, direction: inverse}}
  - !<ColorSpace> {name: numbers, isdata: true}
"""


def write_config(folder: Path, middle: float = 0.25, text: str = CONFIG) -> str:
    """A site's configuration whose camera space is a table: .5 is `middle`."""
    (folder / "luts").mkdir(parents=True, exist_ok=True)
    table = f"Version 1\nFrom 0.0 1.0\nLength 3\nComponents 1\n{{\n0.0\n{middle}\n1.0\n}}\n"
    (folder / "luts" / "camera.spi1d").write_text(table)
    (folder / "config.ocio").write_text(text)
    return str(folder / "config.ocio")


@pytest.fixture
def site(tmp_path: Path) -> ColorConfig:
    return fresh_config(write_config(tmp_path / "site"))


@pytest.mark.parametrize(
    ("name", "canonical"),
    [
        ("ACEScg", ACESCG), ("scene_linear", ACESCG), ("lin_ap1_scene", ACESCG), ("Linear Rec.709 (sRGB)", LIN_REC709),
        ("lin_rec709_scene", LIN_REC709), ("sRGB", SRGB), ("ACES2065-1", "ACES2065-1"), ("lin_ap0", "ACES2065-1"),
        ("ACESCCT", "ACEScct"), ("compositing_log", "ACEScct"),
    ],
)  # fmt: skip
def test_names_aliases_and_roles_are_found_in_any_case(name: str, canonical: str) -> None:
    assert open_config(BUILT_IN).canonical(name, "key plate.colorspace") == canonical


def test_unknown_names_are_refused_with_near_names() -> None:
    with pytest.raises(JobError, match=r"no colour space 'ACEScgg'\. Where: key plate\.colorspace.*ACEScg, .*near"):
        open_config(BUILT_IN).canonical("ACEScgg", "key plate.colorspace")
    with pytest.raises(JobError, match=r"no view of the display 'sRGB - Display' 'Filmic'.*Un-tone-mapped"):
        open_config(BUILT_IN).view(LIN_REC709, "Filmic", "key color.view")


def test_a_space_for_data_is_refused(site: ColorConfig) -> None:
    with pytest.raises(JobError, match="'numbers' is for data, not for colours"):
        site.canonical("numbers", "key plate.colorspace")


def test_colours_are_converted_as_the_academy_says_and_back() -> None:
    there, back = (open_config(BUILT_IN).conversion(*pair) for pair in ((ACESCG, LIN_REC709), (LIN_REC709, ACESCG)))
    found = convert(COLORS, there)
    np.testing.assert_allclose(found[0], [0.81727, -0.00862, 0.03920], atol=1e-5)
    np.testing.assert_allclose(found[1], 0.18, rtol=1e-6)
    np.testing.assert_allclose(convert(found, back), COLORS, atol=3e-6)


def test_nothing_to_convert_returns_the_same_array() -> None:
    assert convert(COLORS, Conversion()) is COLORS


def test_srgb_is_our_own_and_open_color_io_agrees() -> None:
    ramp = np.linspace(0, 1, 300, dtype=np.float32).reshape(-1, 3)
    own = convert(ramp, Conversion(SRGB, LIN_REC709))
    assert np.array_equal(own, srgb_decode(ramp).astype(np.float32))
    theirs = convert(ramp, open_config(BUILT_IN).conversion("sRGB Encoded Rec.709 (sRGB)", LIN_REC709))
    np.testing.assert_allclose(own, theirs, atol=1e-6)  # its fast approximation is off by 2e-5


def test_a_view_starts_from_any_space() -> None:
    config = open_config(BUILT_IN)
    grey = np.full((1, 3), 0.18, np.float32)
    for source in (LIN_REC709, ACESCG):
        plain = convert(grey, config.view(source, "un-tone-mapped", "key color.view"))
        np.testing.assert_allclose(plain, srgb_encode(grey), atol=2e-6)
        film = convert(grey, config.view(source, "ACES 2.0 - SDR 100 nits (Rec.709)", "key color.view"))
        np.testing.assert_allclose(film, 0.349, atol=2e-3)


def test_a_sites_tables_and_roles_work_and_standard_identifiers_come_from_the_built_in(site: ColorConfig) -> None:
    assert site.canonical("CAMLOG", "") == "camera log"
    assert site.canonical("scene_linear", "") == ACESCG, "this site calls ACEScg `mine`"
    assert site.canonical("lin_ap0_scene", "") == "lin_ap0_scene"
    np.testing.assert_allclose(
        convert(COLORS, site.conversion("lin_ap0_scene", LIN_REC709)),
        convert(COLORS, open_config(BUILT_IN).conversion("ACES2065-1", LIN_REC709)), atol=1e-5,
    )  # fmt: skip
    half = np.full((1, 3), 0.5, np.float32)
    np.testing.assert_allclose(convert(half, site.conversion("camera log", LIN_REC709)), 0.25, atol=1e-5)
    np.testing.assert_allclose(convert(half / 2, site.view(LIN_REC709, "film", "")), 0.5, atol=1e-5)


def test_a_digest_is_of_the_arithmetic_alone(tmp_path: Path) -> None:
    def digest(name: str, **changes: object) -> str:
        return fresh_config(write_config(tmp_path / name, **changes)).conversion("camera log", LIN_REC709).digest

    known = digest("one")
    assert digest("moved") == known
    assert digest("comment", text=CONFIG + "# a comment\n") == known
    assert digest("table", middle=0.26) != known


def test_an_archive_is_read_like_its_folder(tmp_path: Path) -> None:
    import PyOpenColorIO as ocio

    path, archive = write_config(tmp_path), str(tmp_path / "site.ocioz")
    ocio.Config.CreateFromFile(path).archive(archive)
    found = [fresh_config(one).conversion("camera log", ACESCG) for one in (path, archive)]
    assert found[0].digest == found[1].digest
    np.testing.assert_array_equal(*(convert(COLORS, one) for one in found))


def test_another_configuration_than_that_of_the_digest_is_refused(tmp_path: Path) -> None:
    config = fresh_config(write_config(tmp_path))
    conversion = config.conversion("camera log", LIN_REC709)
    write_config(tmp_path, middle=0.3)
    other = dataclasses.replace(conversion, digest="0" * 32)  # not one that this process has made already
    with pytest.raises(JobError, match=r"another one than when the run began.*config\.ocio.*run again"):
        convert(COLORS, other)


def test_a_missing_table_is_refused_by_name(site: ColorConfig) -> None:
    (Path(site.path).parent / "luts" / "camera.spi1d").unlink()
    with pytest.raises(JobError, match=r"cannot convert from camera log to lin_rec709 \(.*camera\.spi1d"):
        fresh_config(site.path).conversion("camera log", LIN_REC709)


@pytest.mark.parametrize("text", ["", "plain: [", None])
def test_a_configuration_that_cannot_be_read_is_refused(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "config.ocio"
    if text is not None:
        path.write_text(text)
    with pytest.raises(JobError, match=r"OpenColorIO configuration cannot be read.*built-in ACES"):
        ColorConfig(str(path))


def test_where_a_configuration_lies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("OCIO", raising=False)
    assert locate_config("/job", "$OCIO") == BUILT_IN
    monkeypatch.setenv("OCIO", "/site/config.ocio")
    monkeypatch.setenv("SITE", "/site")
    assert locate_config("/job", "$OCIO") == "/site/config.ocio"
    assert locate_config("/job", "color/config.ocio") == "/job/color/config.ocio"
    assert locate_config("/job", "$SITE/c.ocioz") == "/site/c.ocioz"
    assert locate_config("/job", "ocio://default") == BUILT_IN


def test_threads_and_sizes_give_the_same_bits() -> None:
    conversion = open_config(BUILT_IN).view(ACESCG, "ACES 2.0 - SDR 100 nits (Rec.709)", "")
    picture = np.random.default_rng(0).random((8, 37, 3), np.float32) * 4
    alone = convert(picture, conversion)
    with ThreadPoolExecutor(4) as pool:
        assert all(np.array_equal(one, alone) for one in pool.map(lambda _: convert(picture, conversion), range(16)))
    assert np.array_equal(np.concatenate([convert(row, conversion) for row in picture]), alone.reshape(-1, 3))
