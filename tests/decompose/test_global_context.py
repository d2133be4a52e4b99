import numpy as np
import pytest
import torch

from yesnt.decompose.global_context import CONTEXT_SIDE, Square, context_image
from yesnt.decompose.network import sample_at_patch


def _subject(scale=1.0):
    """A disc of radius 40 at row 120, column 90 of 200 x 300 pixels, times `scale`."""
    height, width = round(200 * scale), round(300 * scale)
    y, x = np.mgrid[:height, :width]
    matte = (np.hypot(y - 120 * scale, x - 90 * scale) < 40 * scale).astype(np.float32)
    rgb = np.stack([y / height, x / width, np.ones_like(matte)]).astype(np.float32) * matte
    return rgb, matte


def test_the_square_lies_around_the_subject_wherever_the_frame_ends():
    _, matte = _subject()
    square = Square.around(matte)
    assert 80 <= square.side <= 90
    assert square.top + square.side / 2 == pytest.approx(120, abs=1.5)
    assert square.left + square.side / 2 == pytest.approx(90, abs=1.5)
    moved = Square.around(np.roll(matte, (-80, 0), (0, 1)))
    assert (moved.left, moved.side) == (square.left, square.side)
    assert moved.top == square.top - 80


def test_specks_do_not_shrink_the_subject():
    _, matte = _subject()
    speckled = matte.copy()
    speckled[2:4, 295:297] = 1
    assert Square.around(speckled).side == pytest.approx(Square.around(matte).side, abs=2)


def test_an_empty_matte_gives_a_black_image():
    matte = np.zeros((40, 70), np.float32)
    small = context_image(np.zeros((3, 40, 70), np.float32), matte, Square.around(matte))
    assert small.shape == (4, CONTEXT_SIDE, CONTEXT_SIDE)
    assert not small.any()


@pytest.mark.parametrize("scale", [0.3, 1, 4])
def test_the_context_image_keeps_straight_colours_at_any_size(scale):
    rgb, matte = _subject(scale)
    square = Square.around(matte)
    small = context_image(rgb, matte, square)
    middle = small[:, CONTEXT_SIDE // 2, CONTEXT_SIDE // 2]
    row = min(square.top + square.side // 2, rgb.shape[1] - 1)
    column = min(square.left + square.side // 2, rgb.shape[2] - 1)
    np.testing.assert_allclose(middle[:3], rgb[:, row, column], atol=0.03)
    assert small[2][small[3] > 0.3] == pytest.approx(1, abs=1e-3)
    assert middle[3] == pytest.approx(1)


def test_the_square_leaves_a_margin_of_eight_percent():
    matte = np.zeros((300, 300), np.float32)
    matte[50:250, 100:150] = 1
    assert Square.around(matte) == Square(42, 17, 216)


def test_minification_averages_areas_and_magnification_is_bilinear():
    board = (np.indices((192, 192)).sum(0) % 2).astype(np.float32)[None]
    small = Square(0, 0, 192).resample(board, 96)
    np.testing.assert_allclose(small, 0.5, atol=1e-6)
    ramp = np.broadcast_to(np.arange(48, dtype=np.float32), (48, 48))[None]
    np.testing.assert_allclose(Square(0, 0, 48).resample(ramp, 96)[0, 40, 1:-1], np.arange(1, 95) / 2 - 0.25, atol=1e-5)


def test_a_soft_edge_does_not_darken_or_tint_the_context_image():
    """Straight colours are averaged with their coverage: a red body with a half-covered, wrongly blue edge."""
    matte = np.full((192, 192), 1.0, np.float32)
    rgb = np.zeros((3, 192, 192), np.float32)
    rgb[0], matte[:, 1::2] = 1, 0.25
    rgb[:, :, 1::2] = np.array([0, 0, 1], np.float32)[:, None, None]
    small = context_image(rgb, matte, Square(0, 0, 192))
    np.testing.assert_allclose(small[3], 0.625, atol=1e-6)
    np.testing.assert_allclose(small[0], 0.8, atol=1e-5)
    np.testing.assert_allclose(small[2], 0.2, atol=1e-5)


def test_features_are_sampled_at_the_location_of_the_patch():
    """Sampling the context image's own coordinates at a patch gives the patch's coordinates, for any two patches."""
    _, matte = _subject()
    square = Square.around(matte)
    ramp = (torch.arange(24) + 0.5) / 24
    features = torch.stack([ramp[:, None].expand(24, 24), ramp[None].expand(24, 24)])[None]
    for top, left in ((100, 70), (116, 54)):
        place = torch.tensor([square.locate(top, left, 32)])
        sampled = sample_at_patch(features, place, 8)[0].numpy() * square.side
        pixels = np.arange(8) * 4 + 2
        np.testing.assert_allclose(sampled[0], np.broadcast_to((top + pixels - square.top)[:, None], (8, 8)), atol=1e-3)
        np.testing.assert_allclose(sampled[1], np.broadcast_to(left + pixels - square.left, (8, 8)), atol=1e-3)


def test_beyond_the_square_the_nearest_feature_is_used():
    features = 1 + torch.arange(4.0).reshape(1, 1, 2, 2)
    before, beyond = sample_at_patch(
        features.expand(2, -1, -1, -1), torch.tensor([[-3.0, -3.0, 1.0], [3.0, 3.0, 1.0]]), 2
    )
    assert (before == 1).all()
    assert (beyond == 4).all()
