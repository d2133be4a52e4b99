"""Normals as files store them."""

from __future__ import annotations

import numpy as np

from tests.tiny_shot import write_tiny_shot
from yesnt.core.camera import Camera
from yesnt.core.shot import GBufferInput
from yesnt.io.pictures.surface import world_normals


def test_unsigned_normals_are_zero_where_nothing_was_hit(tmp_path) -> None:
    camera = Camera.open(write_tiny_shot(tmp_path / "shot", 1).parent / "camera.json")
    stored = np.zeros((1, 3, 3), np.float32)
    stored[0, 0], stored[0, 1] = (0.5, 0.0, 0.5), (1.0, 0.5, 0.5)
    found = world_normals(stored, GBufferInput(path="g.exr", normal_range="unsigned"), camera, 1001)
    assert found[0].tolist() == [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
