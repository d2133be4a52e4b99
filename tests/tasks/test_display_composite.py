"""`composite: display` through a job file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.tasks.test_set import delivered, rgb
from tests.tiny_shot import write_tiny_shot
from yesnt.core.color import display_encode
from yesnt.core.errors import JobError
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import load_shot

SETS = [{}, {"set": {"ground": -0.5}}]


@pytest.mark.parametrize("given", SETS, ids=["map", "set"])
def test_it_differs_where_a_pixel_is_covered_in_part(given: dict[str, object], tmp_path: Path) -> None:
    found = {}
    for kind in ("linear", "display"):
        path = write_tiny_shot(tmp_path / kind, 1, composite=kind, matte={"path": "matte.exr"}, **given)
        share = np.where(np.arange(40) < 20, np.float32(0.5), np.float32(1)) * np.ones((32, 1), np.float32)
        write_exr(path.parent / "matte.exr", {"Y": share})
        found[kind] = delivered(path)
    linear, display = found["linear"], found["display"]
    for name in set(linear) - set("RGB"):
        np.testing.assert_array_equal(linear[name], display[name], err_msg=name)
    half = (np.arange(40) < 20)[None] & (linear["relit.A"] > 0)
    behind = (rgb(linear) - rgb(linear, "relit"))[half] / 0.5
    mixed = 0.5 * display_encode(rgb(linear, "relit")[half] / 0.5) + 0.5 * display_encode(behind)
    np.testing.assert_allclose(display_encode(rgb(display)[half]), mixed, atol=2e-3)
    np.testing.assert_allclose(rgb(display)[~half], rgb(linear)[~half], rtol=1e-3)
    assert not list((tmp_path / "display" / "out" / "exr").glob("*.nk")), "its nodes would mix light"


def test_light_groups_of_it_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError) as caught:
        load_shot(write_tiny_shot(tmp_path / "shot", 1, composite="display", exr={"layers": ["light_sun"]}))
    assert "sum up to the composite in linear light only; remove these layers, or `composite: display`" in str(
        caught.value
    )
