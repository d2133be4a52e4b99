"""FLIP: laws, the tone-mapped exposures of its HDR form, and what the wrapper passes on."""

import numpy as np
import pytest

from yesnt.core.color import srgb_encode
from yesnt.metrics.flip import PIXELS_PER_DEGREE, exposure_range, flip_map, hdr_flip_map


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    base = rng.random((8, 10, 3)).repeat(8, 0).repeat(8, 1).astype(np.float32)
    return base, np.clip(base + rng.normal(0, 0.1, base.shape), 0, 1).astype(np.float32)


def aces(linear):
    """Narkowicz's fit of the ACES curve, exposed by 0.6 as in HDR-FLIP."""
    x = 0.6 * np.asarray(linear, float)
    return np.clip((2.51 * x**2 + 0.03 * x) / (2.43 * x**2 + 0.59 * x + 0.14), 0, 1)


def test_identical_pictures_have_no_error(pair):
    base, _ = pair
    assert flip_map(base, base).max() == 0
    assert hdr_flip_map(base, base, (-1.0, 1.0)).max() == 0


def test_symmetric_and_within_the_unit_range(pair):
    a, b = pair
    np.testing.assert_array_equal(flip_map(a, b), flip_map(b, a))
    assert flip_map(a, b).shape == a.shape[:2]
    assert 0 <= flip_map(a, b).min() <= flip_map(a, b).max() <= 1


def test_green_against_blue_is_the_largest_colour_error():
    green, blue = (np.tile(np.float32(c), (32, 32, 1)) for c in ((0, 1, 0), (0, 0, 1)))
    np.testing.assert_allclose(flip_map(green, blue), 1, atol=1e-6)  # float32


def test_more_noise_is_worse(pair):
    base, _ = pair
    noise = np.random.default_rng(4).normal(0, 1, base.shape)
    means = [flip_map(np.clip(base + s * noise, 0, 1), base).mean() for s in (0.01, 0.05, 0.2)]
    assert means[0] < means[1] < means[2]


def test_a_viewer_farther_away_sees_less_of_fine_noise(pair):
    a, b = pair
    near, default, far = (flip_map(a, b, ppd).mean() for ppd in (30, PIXELS_PER_DEGREE, 150))
    assert near > default > far
    assert default == flip_map(a, b).mean()
    radiances = a * 2, b * 2
    assert hdr_flip_map(*radiances, (0.0, 1.0), 30).mean() > hdr_flip_map(*radiances, (0.0, 1.0), 150).mean()


def test_views_and_float64_are_taken_as_they_are(pair):
    a, b = (picture.astype(np.float64) for picture in pair)
    np.testing.assert_array_equal(flip_map(a[4:60, ::2], b[4:60, ::2]), flip_map(a[4:60, ::2].copy(), b[4:60, ::2]))


def test_hdr_is_the_worst_tone_mapped_exposure(pair):
    truth = (pair[0] ** 4 * 30 + 0.01).astype(np.float32)
    other = (truth * 1.3 + 0.05 * pair[1]).astype(np.float32)
    exposures = exposure_range(truth)
    each = [flip_map(*(srgb_encode(aces(p * 2.0**stops)) for p in (other, truth))) for stops in exposures]
    np.testing.assert_allclose(hdr_flip_map(other, truth, exposures), np.max(each, axis=0), atol=1e-4)
    assert (np.max(each, axis=0) > each[0] + 0.05).any()  # one exposure alone would not do


def test_exposures_bring_the_maximum_and_the_median_to_the_same_tone(pair):
    truth = (pair[0] ** 4 * 30 + 0.01).astype(np.float32)
    exposures = exposure_range(truth)
    light = np.sort((truth @ np.array([0.2126, 0.7152, 0.0722])).ravel())
    assert aces(light[-1] * 2.0 ** exposures[0]) == pytest.approx(0.85, abs=1e-3)
    assert aces(light[light.size // 2] * 2.0 ** exposures[-1]) == pytest.approx(0.85, abs=1e-3)
    steps = np.diff(exposures)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    assert len(exposures) == np.ceil(exposures[-1] - exposures[0])
    assert len(exposure_range(np.full((8, 8, 3), 0.5))) == 2


def test_pictures_of_two_shapes_are_refused_by_name(pair):
    a, b = pair
    with pytest.raises(ValueError, match=r"one shape \[H, W, 3\], not \(64, 80, 3\) and \(64, 79, 3\)"):
        flip_map(a, b[:, 1:])
    with pytest.raises(ValueError, match="one shape"):
        hdr_flip_map(a[..., 0], b[..., 0], (0.0, 1.0))
