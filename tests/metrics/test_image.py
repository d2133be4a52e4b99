"""PSNR, SSIM and alignment: laws, then formulas and scikit-image."""

import math

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from yesnt.metrics.image import channel_scale, decibels, psnr, ssim_map


@pytest.fixture
def pair():
    rng = np.random.default_rng(1)
    base = np.clip(rng.random((7, 9, 3)).repeat(8, 0).repeat(8, 1), 0, 1)
    return base, np.clip(base + rng.normal(0, 0.05, base.shape), 0, 1)


def test_identical_pictures_are_perfect(pair):
    base, _ = pair
    assert psnr(base, base) == math.inf
    np.testing.assert_allclose(ssim_map(base, base), 1)


def test_symmetric(pair):
    a, b = pair
    assert psnr(a, b) == psnr(b, a)
    np.testing.assert_allclose(ssim_map(a, b), ssim_map(b, a))


def test_closed_form_of_a_constant_difference():
    assert psnr(np.full((4, 4, 3), 0.3), np.full((4, 4, 3), 0.4)) == pytest.approx(20)
    assert decibels(0.01, peak=10) == pytest.approx(40)


def test_constant_pictures_have_the_closed_form_of_ssim():
    c1, a, b = 0.01**2, 0.2, 0.6
    flat = ssim_map(np.full((16, 16, 3), a), np.full((16, 16, 3), b))
    np.testing.assert_allclose(flat, (2 * a * b + c1) / (a * a + b * b + c1))


def test_more_noise_is_worse(pair):
    base, _ = pair
    noise = np.random.default_rng(2).normal(0, 1, base.shape)
    levels = [base + sigma * noise for sigma in (0.01, 0.03, 0.1, 0.3)]
    assert (np.diff([psnr(x, base) for x in levels]) < 0).all()
    assert (np.diff([ssim_map(x, base).mean() for x in levels]) < 0).all()


def test_the_mask_is_all_that_counts(pair):
    a, b = pair
    mask = np.zeros(a.shape[:2], bool)
    mask[10:20, 10:30] = True
    wrecked = np.where(mask[..., None], b, 77.0)
    assert psnr(a, wrecked, mask) == psnr(a, b, mask)


def test_psnr_equals_scikit_images(pair):
    a, b = pair
    assert psnr(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=1), abs=1e-9)


def test_ssim_is_wangs_formula_in_every_window(pair):
    """Gaussian moments of 1.5 px over 11 px, mirrored at the border, written out with SciPy's filter."""
    from scipy.ndimage import gaussian_filter

    x, y = pair

    def blur(plane):
        return gaussian_filter(plane, (1.5, 1.5, 0), mode="reflect", radius=(5, 5, 0))

    mx, my = blur(x), blur(y)
    top = (2 * mx * my + 0.01**2) * (2 * (blur(x * y) - mx * my) + 0.03**2)
    bottom = (mx**2 + my**2 + 0.01**2) * (blur(x * x) - mx**2 + blur(y * y) - my**2 + 0.03**2)
    np.testing.assert_allclose(ssim_map(x, y), (top / bottom).mean(-1), atol=1e-9)


def test_ssim_does_not_depend_on_the_type(pair):
    """scikit-image would work in float32, which is off by 7e-5."""
    a, b = (picture.astype(np.float32) for picture in pair)
    np.testing.assert_array_equal(ssim_map(a, b), ssim_map(a.astype(np.float64), b.astype(np.float64)))


def test_alignment_undoes_any_channel_gain(pair):
    truth, _ = pair
    gains = np.array([0.5, 2.0, 7.0])
    mask = np.ones(truth.shape[:2], bool)
    np.testing.assert_allclose(channel_scale(truth * gains, truth, mask), 1 / gains)
    assert channel_scale(truth * [0, 1, 1], truth, mask)[0] == 1


def test_alignment_never_raises_the_linear_error(pair):
    truth, other = pair
    mask = np.ones(truth.shape[:2], bool)
    assert psnr(other * channel_scale(other, truth, mask), truth) >= psnr(other, truth)
