"""Windows of frames: where they lie, how they are blended, when drawing stops."""

from itertools import pairwise

import numpy as np
import pytest

from yesnt.decompose.backend import Footprint
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.window import blend, estimate_clip, make_clip, plan_windows


class FakeVideo:
    """roughness = the mean colour of the clip plus noise of the member, metallic = the matte."""

    footprint = Footprint(None, 1, 3, 4, 1)

    def __init__(self, gain=0.1):
        self.gain, self.drawn = gain, []

    def draw(self, clip, seed, members, settings):
        for member in members:
            self.drawn.append(member)
            offset = self.gain * np.random.default_rng((seed, clip.frames[0], member)).standard_normal()
            rough = np.full_like(clip.matte, clip.rgb.mean() + offset)
            yield np.stack([rough, clip.matte], axis=1)


@pytest.mark.parametrize(("length", "window", "overlap"), [(1, 4, 1), (3, 4, 1), (4, 4, 3), (43, 24, 6), (99, 24, 12)])
def test_windows_cover_every_frame_with_weights_that_sum_to_one(length, window, overlap):
    windows = plan_windows(length, Footprint(512, 64, 40, window, overlap))
    total = np.zeros(length)
    for one in windows:
        assert len(one.span) == min(window, length) == len(one.weights)
        total[one.span.slice] += one.weights
    np.testing.assert_allclose(total, 1, atol=1e-12)
    for a, b in pairwise(windows):
        assert a.span.stop - b.span.start >= min(overlap, length)


@pytest.mark.parametrize(("length", "window", "overlap"), [(43, 24, 6), (25, 24, 6), (60, 8, 7), (200, 24, 12)])
def test_windows_of_a_lane_never_overlap(length, window, overlap):
    windows = plan_windows(length, Footprint(512, 64, 40, window, overlap))
    for lane in {one.lane for one in windows}:
        spans = [one.span for one in windows if one.lane == lane]
        assert all(a.stop <= b.start for a, b in pairwise(spans))


def test_a_short_clip_repeats_its_last_frame_and_counts_on():
    rgb = [np.full((4, 5, 3), 0.1 * i, np.float32) for i in range(3)]
    clip = make_clip(rgb, [np.ones((4, 5), np.float32)] * 3, (7, 9, 11), 5)
    assert clip.frames == (7, 9, 11, 12, 13)
    np.testing.assert_array_equal(clip.rgb[3], rgb[2])
    np.testing.assert_array_equal(clip.rgb[4], rgb[2])


def test_colour_outside_the_matte_is_black_and_nan_inside_is_refused():
    rgb, matte = np.full((4, 4, 3), np.nan, np.float32), np.zeros((4, 4), np.float32)
    assert not make_clip([rgb], [matte], (1,), 2).rgb.any()
    with pytest.raises(ValueError, match="NaN"):
        make_clip([rgb], [matte + 1], (1,), 2)


def test_mean_and_population_deviation_over_members():
    backend = FakeVideo()
    clip = make_clip([np.full((6, 6, 3), 0.5, np.float32)] * 4, [np.ones((6, 6), np.float32)] * 4, range(4), 4)
    estimate = estimate_clip(clip, backend, EnsembleSettings(5), 3)
    drawn = np.stack(list(FakeVideo().draw(clip, 3, range(5), EnsembleSettings(5))))
    np.testing.assert_allclose(estimate.mean, drawn.mean(0), atol=1e-6)
    np.testing.assert_allclose(estimate.std, drawn.std(0), atol=1e-6)
    assert estimate.members == 5


def test_drawing_stops_when_the_mean_is_known_and_never_begins_without_matte():
    clip = make_clip([np.full((6, 6, 3), 0.5, np.float32)] * 4, [np.ones((6, 6), np.float32)] * 4, range(4), 4)
    assert estimate_clip(clip, FakeVideo(0), EnsembleSettings(16, tolerance=0.01), 0).members == 2
    assert estimate_clip(clip, FakeVideo(0.3), EnsembleSettings(16, tolerance=0.001), 0).members == 16
    empty = make_clip([np.zeros((6, 6, 3), np.float32)], [np.zeros((6, 6), np.float32)], (1,), 4)
    backend = FakeVideo()
    assert estimate_clip(empty, backend, EnsembleSettings(4), 0).members == 0
    assert not backend.drawn


def test_blending_is_the_mixture_and_disagreement_becomes_spread():
    low, high = np.full((2, 3, 3), 0.2, np.float32), np.full((2, 3, 3), 0.6, np.float32)
    std = np.full((2, 3, 3), 0.1, np.float32)
    mean, spread = blend([low, high], [std, std], [0.25, 0.75])
    np.testing.assert_allclose(mean, 0.5, atol=1e-6)
    np.testing.assert_allclose(spread, np.sqrt(0.01 + 0.25 * 0.09 + 0.75 * 0.01), atol=1e-6)
    same, same_std = blend([low, low], [std, std], [0.3, 0.7])
    np.testing.assert_allclose(same, low, atol=1e-6)
    np.testing.assert_allclose(same_std, std, atol=1e-6)
