"""Laws of compositing with associated alpha."""

from __future__ import annotations

import numpy as np
import pytest

from yesnt.core.color import display_decode, display_encode, luminance, srgb_encode, straighten
from yesnt.scene.composite import Behind, associate, held_out, over, over_in_display


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


def test_a_known_foreground_over_ten_backgrounds_is_the_direct_render():
    """Hair-thin coverage, stored as half and made straight, loses no more than a thousandth; energy from 0 to 100."""
    rng = np.random.default_rng(3)
    hair = np.where(rng.random((32, 32)) < 0.5, rng.uniform(0.004, 0.2, (32, 32)), 0).astype(np.float32)
    color = rng.uniform(0.05, 4, (32, 32, 3)).astype(np.float32)
    stored = associate(color, hair).astype(np.float16).astype(np.float32)
    again = associate(straighten(stored[..., :3], stored[..., 3]), stored[..., 3])
    for level in (0, 0.01, 0.1, 0.5, 1, 2, 5, 10, 50, 100):
        background = np.full((32, 32, 3), level, np.float32)
        direct = color * hair[..., None] + (1 - hair[..., None]) * background
        found = over(again, background)[..., :3]
        assert np.abs(found - direct).max() < 1e-3 * max(1, level)


def test_what_is_behind_with_the_subject_is_shadow_times_picture_plus_reflection():
    rng = np.random.default_rng(5)
    picture = np.concatenate([rng.uniform(0, 100, (6, 7, 3)), np.ones((6, 7, 1))], axis=-1).astype(np.float32)
    ratio = rng.uniform(0, 1, (6, 7, 3)).astype(np.float32)
    ratio[:2] = 1
    added = rng.uniform(0, 1, (6, 7, 3)).astype(np.float32)
    added[:2] = 0
    behind = Behind(picture, ratio, added, np.zeros((6, 7), np.float32))
    shadow, reflection = behind.shadow(), behind.reflection()
    np.testing.assert_array_equal(shadow[:2], 1)
    np.testing.assert_array_equal(reflection[:2], 0)
    assert ((shadow >= 0) & (shadow <= 1)).all()
    np.testing.assert_allclose(
        shadow[..., None] * picture[..., :3] + reflection, behind.with_subject()[..., :3], rtol=1e-5, atol=1e-4
    )
    np.testing.assert_allclose(
        luminance(reflection), luminance(added), atol=1e-3, err_msg="the tint of a shadow has no luminance"
    )


def test_a_held_out_foreground_lets_the_background_through():
    fg = associate(np.full((1, 3, 3), 2, np.float32), np.ones((1, 3), np.float32))
    found = over(held_out(fg, np.array([[0, 0.5, 1]], np.float32)), np.full((1, 3, 3), 8, np.float32))
    np.testing.assert_allclose(found[0, :, 0], [2, 5, 8])


def test_the_display_composite_mixes_code_values() -> None:
    """Half of white over black is middle grey on a display, and a fifth of the light; what is whole stays."""
    draw = np.random.default_rng(4)
    alpha = draw.uniform(0, 1, (4, 5)).astype(np.float32)
    alpha[0, 0], alpha[0, 1] = 0, 1
    color, picture = (draw.uniform(0, 100, (4, 5, 3)).astype(np.float32) for _ in range(2))
    found = over_in_display(associate(color, alpha), picture)
    mixed = alpha[..., None] * display_encode(color) + (1 - alpha[..., None]) * display_encode(picture)
    np.testing.assert_allclose(display_encode(found[..., :3]), mixed, rtol=1e-4)
    np.testing.assert_allclose(found[0, :2, :3], [picture[0, 0], color[0, 1]], rtol=1e-4)
    white = associate(np.ones((1, 1, 3), np.float32), np.array([[0.5]], np.float32))
    grey = over_in_display(white, np.zeros((1, 1, 3), np.float32))
    np.testing.assert_allclose(grey[0, 0], [0.2140] * 3 + [1], atol=1e-4)


def test_the_display_composite_keeps_alpha_and_light_without_coverage() -> None:
    flame = np.array([[[3, 2, 1, 0], [0.5, 0.5, 0.5, 0.5]]], np.float32)
    behind = np.array([[[0.2, 0.2, 0.2, 0.5], [0, 0, 0, 0]]], np.float32)
    found = over_in_display(flame, behind)
    np.testing.assert_allclose(found, [[[3.2, 2.2, 1.2, 0.5], [0.5, 0.5, 0.5, 0.5]]], rtol=1e-5)


def test_display_encoding_is_srgb_up_to_white_and_inverts_beyond() -> None:
    x = np.linspace(-2, 100, 999)
    np.testing.assert_allclose(display_decode(display_encode(x)), x, rtol=1e-9, atol=1e-12)
    inside = np.linspace(0, 1, 99)
    np.testing.assert_array_equal(display_encode(inside), srgb_encode(inside))
