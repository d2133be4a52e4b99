import tracemalloc

import numpy as np
import pytest
import torch

from yesnt.decompose import ensemble
from yesnt.decompose.blend import PatchGrid
from yesnt.decompose.confidence import confidence
from yesnt.decompose.ensemble import decompose_frame, estimate_frame
from yesnt.decompose.noise_planes import member_noise
from yesnt.decompose.settings import EnsembleSettings


@pytest.fixture
def picture():
    rng = np.random.default_rng(1)
    rgb = rng.random((80, 70, 3), dtype=np.float32) * 0.5 + 0.25
    matte = np.zeros((80, 70), np.float32)
    matte[10:60, 20:55] = 1
    return rgb, matte


def reference(rgb, matte, gain, samples, key):
    """Members of the fake backend without any patches."""
    grid = PatchGrid.cover(*matte.shape, 32, 0.25)
    members = [
        np.clip(
            rgb[..., 0] * (matte > 0) + gain * member_noise((*key, k), grid.height, grid.width, (0.0, 6.0))[1], 0, 1
        )
        for k in range(samples)
    ]
    return np.mean(members, 0), np.std(members, 0)


def test_pointwise_model_shows_no_seams_and_spread_is_the_population_std(fake, picture):
    rgb, matte = picture
    mean, std = decompose_frame(rgb, matte, fake(0.05), EnsembleSettings(5, antithetic=False), 3, 1001)
    expected_mean, expected_std = reference(rgb, matte, 0.05, 5, (3, 1001))
    inside = matte > 0
    np.testing.assert_allclose(mean[0][inside], expected_mean[inside], atol=1e-6)
    np.testing.assert_allclose(std[0][inside], expected_std[inside], atol=2e-6)
    np.testing.assert_allclose(mean[1][inside], 1, atol=1e-6)
    np.testing.assert_allclose(std[1][inside], 0, atol=1e-6)


def test_nothing_is_estimated_outside_the_matte(fake, picture):
    rgb, matte = picture
    estimate = estimate_frame(rgb, matte, fake(), EnsembleSettings(3), 0, 1)
    for plane in (*estimate.mean, *estimate.std, estimate.nfe):
        assert not plane[matte == 0].any()


def test_empty_matte_costs_nothing(fake, picture):
    backend = fake()
    estimate = estimate_frame(picture[0], np.zeros_like(picture[1]), backend, EnsembleSettings(3), 0, 1)
    assert backend.sampled == 0
    assert estimate.total_nfe == 0
    assert not estimate.mean.any()


def test_colour_outside_the_matte_does_not_matter_even_nan(fake, picture):
    rgb, matte = picture
    dirty = np.where(matte[..., None] > 0, rgb, np.nan).astype(np.float32)
    settings = EnsembleSettings(2)
    clean = decompose_frame(rgb, matte, fake(), settings, 0, 1)
    for a, b in zip(clean, decompose_frame(dirty, matte, fake(), settings, 0, 1), strict=True):
        np.testing.assert_array_equal(a, b)


def test_frames_smaller_than_a_patch(fake, picture):
    rgb, matte = picture[0][12:30, 22:40], picture[1][12:30, 22:40]
    mean, std = decompose_frame(rgb, matte, fake(0.0), EnsembleSettings(2), 0, 1)
    assert mean.shape == std.shape == (2, 18, 18)
    np.testing.assert_allclose(mean[0], rgb[..., 0], atol=1e-6)


def test_batch_size_of_the_backend_does_not_change_a_bit(fake, picture):
    settings = EnsembleSettings(3)
    results = {
        np.concatenate(decompose_frame(*picture, fake(batch=batch), settings, 0, 1)).tobytes()
        for batch in (1, 3, 4, 16)
    }
    assert len(results) == 1


def test_members_in_memory_do_not_change_a_bit(fake, picture, monkeypatch):
    settings = EnsembleSettings(5)
    whole = np.concatenate(decompose_frame(*picture, fake(), settings, 0, 1))
    monkeypatch.setattr("yesnt.decompose.ensemble._MEMORY_FOR_MEMBERS", 1)
    np.testing.assert_array_equal(whole, np.concatenate(decompose_frame(*picture, fake(), settings, 0, 1)))


def test_noise_is_keyed_by_seed_frame_and_member(fake, picture):
    def run(seed, frame, samples=2):
        return np.concatenate(decompose_frame(*picture, fake(), EnsembleSettings(samples), seed, frame))

    np.testing.assert_array_equal(run(0, 1001), run(0, 1001))
    assert (run(0, 1001) != run(1, 1001)).any()
    assert (run(0, 1001) != run(0, 1002)).any()
    one, two = run(0, 1001, 1), run(0, 1001, 2)
    assert (one[2:] == 0).all(), "one member has no spread"
    assert (one[:2] != two[:2]).any()


def test_opposite_members_cancel_what_is_odd_in_the_noise(fake, picture):
    rgb, matte = picture
    inside = matte > 0
    mean, std = decompose_frame(rgb, matte, fake(0.05), EnsembleSettings(2), 0, 1)
    np.testing.assert_allclose(mean[0][inside], rgb[..., 0][inside], atol=1e-6)
    alone = decompose_frame(rgb, matte, fake(0.05), EnsembleSettings(2, antithetic=False), 0, 1)[0]
    assert np.abs(alone[0] - rgb[..., 0])[inside].max() > 0.01
    expected = 0.05 * np.abs(member_noise((0, 1, 0), *PatchGrid.cover(80, 70, 32, 0.25).shape, (0.0, 6.0))[1])
    np.testing.assert_allclose(std[0][inside], expected[:80, :70][inside], atol=2e-6)


def test_smooth_noise_planes_are_standard_normal():
    planes = np.stack([member_noise((0, 1, k), 64, 96, (0.0, 3.0, 20.0)) for k in range(200)])
    np.testing.assert_allclose(planes.mean((0, 2, 3)), 0, atol=0.1)
    np.testing.assert_allclose(planes.var((0, 2, 3)), 1, atol=0.1)
    assert np.abs(np.diff(planes[:, 2], axis=2)).mean() < 0.1 * np.abs(np.diff(planes[:, 0], axis=2)).mean()


def test_tolerance_zero_is_the_fixed_ensemble_and_a_tiny_one_reaches_all_members(fake, picture):
    fixed = estimate_frame(*picture, fake(), EnsembleSettings(8), 0, 1)
    tiny = estimate_frame(*picture, fake(), EnsembleSettings(8, tolerance=1e-9), 0, 1)
    np.testing.assert_allclose(tiny.mean, fixed.mean, atol=1e-6)
    np.testing.assert_allclose(tiny.std, fixed.std, atol=1e-5)
    assert tiny.total_nfe == fixed.total_nfe


def test_sampling_stops_where_the_mean_has_converged(fake, picture):
    rgb, matte = picture
    matte = np.ones_like(matte)
    certain = np.where(np.arange(70)[None, :, None] < 35, 0.0, 0.5).astype(np.float32) * np.ones_like(rgb)

    class HalfCertain(fake):
        def sample(self, condition, noise):
            noise = noise * (condition[:, :1].amin((2, 3), keepdim=True) > 0)
            return super().sample(condition, noise)

    fixed = estimate_frame(certain, matte, HalfCertain(), EnsembleSettings(16), 0, 1)
    adaptive = estimate_frame(certain, matte, HalfCertain(), EnsembleSettings(16, tolerance=0.004), 0, 1)
    assert adaptive.total_nfe < 0.8 * fixed.total_nfe
    assert adaptive.nfe[:, :5].max() == pytest.approx(2 * 3)
    assert adaptive.nfe.max() == pytest.approx(16 * 3)
    np.testing.assert_allclose(adaptive.mean[0], fixed.mean[0], atol=0.1)


def test_evaluations_are_counted_per_pixel_and_in_all(fake):
    """One patch, five members of three evaluations each."""
    rgb, matte = np.full((32, 32, 3), 0.5, np.float32), np.ones((32, 32), np.float32)
    estimate = estimate_frame(rgb, matte, fake(), EnsembleSettings(5), 0, 1)
    np.testing.assert_allclose(estimate.nfe, 15, rtol=1e-6)
    assert estimate.total_nfe == 15


def test_members_are_clipped_before_they_are_averaged(fake, picture):
    rgb, matte = picture
    mean, std = decompose_frame(rgb, matte, fake(2.0), EnsembleSettings(5, antithetic=False), 3, 1001)
    expected_mean, expected_std = reference(rgb, matte, 2.0, 5, (3, 1001))
    inside = matte > 0
    np.testing.assert_allclose(mean[0][inside], expected_mean[inside], atol=1e-6)
    np.testing.assert_allclose(std[0][inside], expected_std[inside], atol=2e-6)


def test_only_the_error_inside_the_matte_keeps_a_patch_active(fake, picture):
    class NoisyOutside(fake):
        def sample(self, condition, noise):
            return super().sample(condition, noise * (condition[:, 1:] == 0))

    estimate = estimate_frame(*picture, NoisyOutside(0.3), EnsembleSettings(16, tolerance=0.01), 0, 1)
    assert estimate.nfe.max() == pytest.approx(2 * 3)


def test_the_mean_is_predicted_once_per_patch_however_many_blocks_of_members(fake, picture, monkeypatch):
    calls = []

    class Knowing(fake):
        def predict_mean(self, condition):
            calls.append(len(condition))
            return condition

    backend = Knowing()
    monkeypatch.setattr(ensemble, "_MEMORY_FOR_MEMBERS", 1)
    estimate_frame(*picture, backend, EnsembleSettings(4), 0, 1)
    assert len(calls) == backend.sampled / 4


def test_rounds_double():
    assert EnsembleSettings(16, tolerance=0.1).rounds() == (range(0, 2), range(2, 4), range(4, 8), range(8, 16))
    assert EnsembleSettings(5, tolerance=0.1).rounds() == (range(0, 2), range(2, 4), range(4, 5))
    assert EnsembleSettings(5).rounds() == (range(0, 5),)


def test_confidence_runs_from_one_to_zero():
    std = np.array([0, 0.25, 0.5, 0.9], np.float32)
    np.testing.assert_allclose(confidence(std, 0.5), [1, 0.5, 0, 0])  # the paper's divisor
    np.testing.assert_allclose(confidence(std), [1, 5 / 6, 2 / 3, 0.4], rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"samples": 0}, "samples"),
        ({"overlap": 1.0}, "overlap"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"first": 1}, "first"),
    ],
)
def test_settings_without_meaning_are_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        EnsembleSettings(**arguments)


def test_shapes_and_values_are_checked(fake, picture):
    rgb, matte = picture
    with pytest.raises(ValueError, match="H, W, 3"):
        decompose_frame(rgb[:-1], matte, fake(), EnsembleSettings(1), 0, 1)
    broken = rgb.copy()
    broken[30, 30] = np.inf
    with pytest.raises(ValueError, match="NaN or Inf"):
        decompose_frame(broken, matte, fake(), EnsembleSettings(1), 0, 1)


def test_results_are_plain_float32(fake, picture):
    for plane in decompose_frame(*picture, fake(), EnsembleSettings(2), 0, 1):
        assert plane.dtype == np.float32
        assert plane.flags.c_contiguous
    assert torch.is_grad_enabled()


def test_a_predicted_mean_replaces_the_sample_mean_and_members_give_the_spread(fake, picture):
    class Knowing(fake):
        def predict_mean(self, condition):
            return torch.cat([0 * condition[:, :1] + 0.25, condition[:, 1:]], 1)

    rgb, matte = picture
    for samples in (2, 8):
        drawn, known = (estimate_frame(rgb, matte, b, EnsembleSettings(samples), 0, 1) for b in (fake(), Knowing()))
        inside = matte > 0
        np.testing.assert_allclose(known.mean[0][inside], 0.25, atol=1e-6)
        np.testing.assert_array_equal(known.std, drawn.std)
        assert known.total_nfe == drawn.total_nfe


def test_a_predicted_mean_lets_sampling_stop_sooner(fake, picture):
    class Knowing(fake):
        def predict_mean(self, condition):
            return condition

    settings = EnsembleSettings(16, tolerance=0.02, antithetic=False)
    plain, knowing = (estimate_frame(*picture, b, settings, 0, 1).total_nfe for b in (fake(0.1), Knowing(0.1)))
    assert knowing < plain


@pytest.mark.parametrize("samples", [2, 6])
def test_memory_per_pixel_is_bounded_whatever_the_members(fake, monkeypatch, samples):
    """At 4K a hundred and sixty bytes a pixel beside torch and the inputs keep a frame below 2 GB."""

    class Embedded(fake):
        noise_sigmas = (0.0, 0.0, 4.0, 16.0, 64.0) * 2

        def predict_mean(self, condition):
            return condition[:, :2]

    monkeypatch.setattr(ensemble, "_MEMORY_FOR_MEMBERS", 1)  # what is a member's at 4K
    rgb, matte = np.full((512, 512, 3), 0.3, np.float32), np.ones((512, 512), np.float32)
    tracemalloc.start()
    estimate_frame(rgb, matte, Embedded(patch=128), EnsembleSettings(samples), 0, 1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 160 * matte.size
