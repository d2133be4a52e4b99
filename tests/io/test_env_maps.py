"""Environment maps: their colour space as the file states it, infinite and negative radiance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cases.shots import ACES_AP1, sky, window, write
from yesnt.core.color_spaces import ACESCG, LIN_REC709
from yesnt.core.errors import JobError
from yesnt.io.color_config import BUILT_IN, open_config
from yesnt.io.env_maps import read_radiance
from yesnt.relight import EnvMap


def test_a_map_of_the_python_interface_is_in_the_space_that_its_file_states(tmp_path: Path) -> None:
    write(tmp_path / "plain.exr", sky(0.5))
    write(tmp_path / "aces.exr", sky(np.array([0.5, 0.05, 0.05])), chromaticities=ACES_AP1)
    write(tmp_path / "odd.exr", sky(0.5), chromaticities=(0.6, 0.35, 0.3, 0.55, 0.2, 0.1, 0.3127, 0.329))
    oiio.ImageBuf(np.full((16, 32, 3), 0.5, np.float32)).write(str(tmp_path / "display.png"), "uint8")
    assert EnvMap.open(tmp_path / "plain.exr").radiance[0, 0].tolist() == [0.5] * 3
    assert EnvMap.open(tmp_path / "aces.exr").radiance[0, 0] == pytest.approx([0.8173, 0, 0.0392], abs=1e-3)
    assert EnvMap.open(tmp_path / "display.png").radiance[0, 0] == pytest.approx([0.2158] * 3, abs=1e-3)
    with pytest.raises(JobError, match=r"env map has chromaticities 0\.6, .*no space that is known"):
        EnvMap.open(tmp_path / "odd.exr")


def spoiled(path: Path, *values: float) -> Path:
    """A map of radiance 1 that begins with other values."""
    planes = {name: plane.copy() for name, plane in sky(1.0).items()}
    planes["R"][0, : len(values)] = values
    write(path, planes)
    return path


def test_infinite_radiance_takes_the_clamp_before_the_space_changes(tmp_path: Path) -> None:
    path = spoiled(tmp_path / "a.exr", np.inf, 7.0)
    plain = read_radiance(path, clamp=5.0)
    assert (plain.infinite, plain.negative, plain.values[0, :2, 0].tolist()) == (1, 0, [5, 7])
    aces = read_radiance(path, open_config(BUILT_IN).conversion(LIN_REC709, ACESCG), clamp=5.0)
    assert np.isfinite(aces.values).all()
    with pytest.raises(JobError, match=r"1 values are NaN or Inf.*or set `clamp` for this map"):
        read_radiance(path)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_a_clamp_mends_nothing_else(tmp_path: Path, value: float) -> None:
    with pytest.raises(JobError, match=r"1 values are NaN or Inf.*Do: mend this picture"):
        read_radiance(spoiled(tmp_path / "a.exr", value), clamp=5.0)


def test_negative_radiance_is_counted_in_the_target_space(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", sky(np.array([0.5, 0.05, 0.05])))
    conversion = open_config(BUILT_IN).conversion(ACESCG, LIN_REC709)
    found = read_radiance(tmp_path / "a.exr", conversion)
    assert (found.negative, found.values[..., 1].max()) == (16 * 32, 0)


def test_a_map_is_its_display_window(tmp_path: Path) -> None:
    whole = {name: plane.copy() for name, plane in sky(np.random.default_rng(0).random((16, 32, 3))).items()}
    upper = {name: plane[:8] for name, plane in whole.items()}
    write(tmp_path / "a.exr", upper, dataWindow=window(0, 0, 32, 8), displayWindow=window(0, 0, 32, 16))
    found = read_radiance(tmp_path / "a.exr").values
    np.testing.assert_array_equal(found[:8, :, 0], whole["R"][:8])
    assert found.shape == (16, 32, 3)
    assert not found[8:].any()


def test_a_maps_layer_is_chosen_by_name(tmp_path: Path) -> None:
    values = {"sky": 1.0, "sun": 5.0}
    write(tmp_path / "a.exr", {f"{name}.{c}": plane for name, v in values.items() for c, plane in sky(v).items()})
    assert read_radiance(tmp_path / "a.exr", layer="sun").values.max() == 5
    with pytest.raises(JobError, match=r"Several layers may be light's colour: sky, sun"):
        read_radiance(tmp_path / "a.exr")
