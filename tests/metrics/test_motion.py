"""Videos and flow: what must be infinite, zero or one."""

import math

import numpy as np
import pytest

from yesnt.metrics.motion import measure_flow, measure_lengths, tpsnr_diff, tpsnr_warp


@pytest.fixture
def video():
    """A random picture that moves 2 pixels to the right a frame."""
    wide = np.random.default_rng(9).random((20, 40, 3))
    return np.stack([wide[:, 8 - 2 * t : 28 - 2 * t] for t in range(4)])


MATTE = np.ones((4, 20, 20), bool)
FLOW = np.tile(np.float32([2, 0]), (3, 20, 20, 1))
SEEN = np.ones((3, 20, 20), bool)


def test_a_true_video_is_perfect(video):
    assert tpsnr_diff(video, video, MATTE) == math.inf
    assert tpsnr_warp(video, FLOW, SEEN, MATTE) > 120  # float32 weights


def test_a_constant_error_is_no_flicker_and_an_alternating_one_is(video):
    assert tpsnr_diff(video + 0.1, video, MATTE) > 200
    flicker = video + 0.1 * np.array([1, -1, 1, -1])[:, None, None, None]
    assert tpsnr_diff(flicker, video, MATTE) == pytest.approx(-20 * math.log10(0.2))
    assert tpsnr_warp(flicker, FLOW, SEEN, MATTE) == pytest.approx(-20 * math.log10(0.2), abs=1e-3)


def test_warping_equals_scipys_bilinear_sampling(video):
    from scipy.ndimage import map_coordinates

    flow = np.random.default_rng(12).uniform(-1.5, 1.5, FLOW.shape).astype(np.float32)
    inner = np.zeros_like(SEEN)
    inner[:, 3:-3, 3:-3] = True
    rows, columns = np.indices((20, 20))
    errors = []
    for t in range(3):
        at = [rows + flow[t, ..., 1], columns + flow[t, ..., 0]]
        fetched = np.stack([map_coordinates(video[t + 1][..., c], at, order=1) for c in range(3)], -1)
        errors.append((fetched - video[t])[inner[t]])
    theirs = -10 * math.log10(np.mean(np.square(errors)))
    assert tpsnr_warp(video, flow, inner, MATTE) == pytest.approx(theirs, abs=1e-3)


def test_a_frozen_video_is_told_by_tlp():
    truth = np.array([0.1, 0.3])
    found = {m.name: m.value for m in measure_lengths(np.zeros(2), truth)}
    assert found["ppl"] == 0
    assert found["tlp"] == pytest.approx(20)


def test_flow_against_truth():
    hidden = np.zeros((3, 20, 20), bool)
    hidden[:, :, :5] = True
    valid = ~hidden
    valid[:, :, 19] = False
    found = {
        m.name: m.value for m in measure_flow(FLOW + np.float32([3, 4]), FLOW, valid, ~hidden, np.ones_like(hidden))
    }
    assert found["epe"] == pytest.approx(5)
    assert found["occlusion_recall"] == 1
    assert found["occlusion_precision"] == pytest.approx(5 / 6)
    nothing = {m.name: m.value for m in measure_flow(FLOW, FLOW, SEEN, SEEN, np.ones_like(hidden))}
    assert nothing["epe"] == 0
    assert math.isnan(nothing["occlusion_recall"])
