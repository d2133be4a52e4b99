"""Layers of the EXR that a job asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cases.shots import deliver, write_shot


def test_base_color_is_delivered_straight_where_the_job_asks_for_it(tmp_path: Path) -> None:
    usual = deliver(write_shot(tmp_path / "usual")).planes
    more = deliver(write_shot(tmp_path / "more", exr={"layers": ["base_color"]}))
    names = {f"base_color.{c}" for c in "RGB"}
    assert set(more.planes) - set(usual) == names
    assert more.centre("base_color") == pytest.approx([0.47] * 3, abs=0.05)  # 0.5 seen, less the reflection
    for name, plane in usual.items():
        np.testing.assert_array_equal(plane, more.planes[name])
