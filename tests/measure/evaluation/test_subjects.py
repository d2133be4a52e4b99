"""Shots with truth, found and read."""

import numpy as np
import pytest

from yesnt.core.errors import JobError
from yesnt.measure.evaluation.subjects import find_subjects
from yesnt.metrics.occlusion import visible_in_next


def test_shots_are_named_by_their_place_in_the_set(shot):
    (subject,) = find_subjects(shot.parent)
    assert subject.name == "ball"
    assert [name for name, _ in subject.maps] == ["dusk", "noon"]
    assert find_subjects(shot)[0].name == "ball"


def test_a_map_may_lie_beside_the_set(shot):
    (shot / "env" / "dusk.exr").rename(shot.parent / "dusk.exr")
    with pytest.raises(JobError, match="map dusk is missing"):
        find_subjects(shot.parent)
    (shot.parent / "env").mkdir()
    (shot.parent / "dusk.exr").rename(shot.parent / "env" / "dusk.exr")
    assert find_subjects(shot.parent)[0].env_path("dusk").parent.parent == shot.parent


def test_coverage_is_divided_out_of_the_material(shot):
    (subject,) = find_subjects(shot)
    whole = subject.read_material(1001, np.ones((40, 40), np.float32)).planes
    half = subject.read_material(1001, np.full((40, 40), 0.5, np.float32)).planes
    np.testing.assert_allclose(half, np.clip(2 * whole, 0, 1), atol=1e-6)


def test_what_is_hidden_is_not_seen():
    z, matte, flow = np.full((8, 8), 2.0), np.ones((8, 8), bool), np.zeros((8, 8, 2))
    nearer = z.copy()
    nearer[:, :5] = 1.5  # something comes before the left part; a bilinear neighbour still shows column 4
    flow[0, :, 1] = -1  # the first row leaves the frame
    seen = visible_in_next(flow, z, nearer, matte, matte)
    assert not seen[0].any()
    assert not seen[1:, :4].any()
    assert seen[1:, 5:].all()
