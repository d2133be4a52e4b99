"""Laws of compositing with associated alpha."""

from __future__ import annotations

import numpy as np
import pytest

from yesnt.scene.composite import associate, over


@pytest.fixture
def layers():
    """Three associated layers [4, 5, 4] with coverage from 0 to 1 and radiance up to 100."""
    rng = np.random.default_rng(7)
    opacity = rng.uniform(0, 1, (3, 4, 5)).astype(np.float32)
    opacity[:, 0, 0], opacity[:, 0, 1] = 0, 1
    return [associate(rng.uniform(0, 100, (4, 5, 3)).astype(np.float32), plane) for plane in opacity]


def test_associate_multiplies_colour_by_coverage():
    found = associate(np.full((1, 2, 3), 8, np.float32), np.array([[0.25, 1]], np.float32))
    np.testing.assert_array_equal(found, [[[2, 2, 2, 0.25], [8, 8, 8, 1]]])


def test_over_is_fg_plus_one_minus_a_times_bg():
    fg, bg = np.array([[[2, 4, 6, 0.25]]], np.float32), np.array([[[8, 8, 8, 0.5]]], np.float32)
    np.testing.assert_allclose(over(fg, bg), [[[8, 10, 12, 0.625]]])


def test_over_is_associative(layers):
    top, middle, bottom = layers
    np.testing.assert_allclose(over(over(top, middle), bottom), over(top, over(middle, bottom)), rtol=1e-5, atol=1e-5)


def test_opaque_hides_and_transparent_changes_nothing(layers):
    top, _, bottom = layers
    found = over(top, bottom)
    np.testing.assert_array_equal(found[0, 0], bottom[0, 0])
    np.testing.assert_array_equal(found[0, 1], top[0, 1])


def test_three_components_count_as_opaque(layers):
    top, _, bottom = layers
    opaque = np.concatenate([bottom[..., :3], np.ones_like(bottom[..., :1])], axis=-1)
    np.testing.assert_array_equal(over(top, bottom[..., :3]), over(top, opaque))


def test_a_uniform_scene_stays_uniform():
    """Coverage has no edge against a background of the same radiance."""
    opacity = np.linspace(0, 1, 11, dtype=np.float32)[None]
    found = over(associate(np.full((1, 11, 3), 7, np.float32), opacity), np.full((1, 11, 3), 7, np.float32))
    np.testing.assert_allclose(found[..., :3], 7, rtol=1e-6)
    np.testing.assert_allclose(found[..., 3], 1, rtol=1e-6)
