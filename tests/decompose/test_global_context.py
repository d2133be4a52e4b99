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
    features = torch.arange(4.0).reshape(1, 1, 2, 2)
    sampled = sample_at_patch(features, torch.tensor([[-3.0, -3.0, 1.0]]), 2)
    assert (sampled == 0).all()
