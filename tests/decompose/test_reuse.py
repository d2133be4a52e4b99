"""Reuse of a keyframe's estimate: laws of the propagation, of the combination, and of what is drawn."""

import numpy as np
import pytest

from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.reuse import Link, Prior, combine, propagate_keyframe
from yesnt.decompose.settings import EnsembleSettings, keyframe_after, keyframes_taken

SETTINGS = EnsembleSettings(4)


def moving(shape, dx, dy, validity=1.0):
    return Link(np.full((*shape, 2), (dx, dy), np.float32), np.full(shape, validity, np.float32))


@pytest.fixture
def estimate():
    rng = np.random.default_rng(0)
    return rng.random((2, 24, 30), dtype=np.float32), 0.1 * rng.random((2, 24, 30), dtype=np.float32)


def test_every_position_takes_from_the_next_multiple_or_the_last_frame():
    assert [keyframe_after(p, 8, 3) for p in range(8)] == [0, 3, 3, 3, 6, 6, 6, 7]
    assert [keyframe_after(p, 5, 1) for p in range(5)] == [0, 1, 2, 3, 4]
    assert keyframe_after(0, 1, 4) == 0


def test_values_come_from_where_the_whole_way_leads(estimate):
    mean, std = estimate
    mattes = [np.ones((24, 30), bool)] * 3
    prior = propagate_keyframe(mean, std, [moving((24, 30), 2, 1), moving((24, 30), 3, 0)], mattes, SETTINGS)
    np.testing.assert_allclose(prior.mean[:, :-1, :-5], mean[:, 1:, 5:], atol=1e-6)
    np.testing.assert_allclose(prior.std[:, :-1, :-5], std[:, 1:, 5:], atol=1e-6)
    assert prior.known[:-1, :-5].all()
    assert not prior.known[:, -5:].any(), "beyond the border nothing is known"
    assert not prior.known[-1].any()


def test_halves_of_a_pixel_are_interpolated(estimate):
    mean, std = estimate
    prior = propagate_keyframe(mean, std, [moving((24, 30), 0.5, 0)], [np.ones((24, 30), bool)] * 2, SETTINGS)
    np.testing.assert_allclose(prior.mean[:, :, :-1], (mean[:, :, :-1] + mean[:, :, 1:]) / 2, atol=1e-6)


def test_invalid_flow_low_confidence_and_missing_matte_make_a_pixel_unknown(estimate):
    mean, std = estimate
    whole = np.ones((24, 30), bool)
    still = [moving((24, 30), 0, 0, 0.7)] * 2
    assert not propagate_keyframe(mean, std, still, [whole] * 3, SETTINGS).known.any(), "0.7 * 0.7 is below one half"
    assert propagate_keyframe(mean, std, still[:1], [whole] * 2, SETTINGS).known.all()
    doubtful = std.copy()
    doubtful[1, :10] = 0.4
    known = propagate_keyframe(mean, doubtful, still[:1], [whole] * 2, SETTINGS).known
    assert not known[:10].any()
    assert known[10:].all()
    gone = whole.copy()
    gone[5:15] = False
    middle_lost = propagate_keyframe(mean, std, [moving((24, 30), 0, 0)] * 2, [whole, gone, whole], SETTINGS).known
    assert not middle_lost[6:14].any()
    assert middle_lost[15:].all()


def test_combining_with_nothing_drawn_or_nothing_known_keeps_the_other(estimate):
    mean, std = estimate
    matte, none, all_ = np.ones((24, 30), np.float32), np.zeros((24, 30), bool), np.ones((24, 30), bool)
    empty = Prior(np.zeros_like(mean), np.zeros_like(std), none)
    known = Prior(mean, std, all_)
    for drawn, share, prior in ((empty, none, known), (known, all_, empty), (known, all_, known)):
        combined = combine(drawn, share.astype(np.float32), prior, matte)
        np.testing.assert_allclose(combined.mean, mean, atol=1e-6)
        np.testing.assert_allclose(combined.std, std, atol=1e-6)


def test_disagreement_increases_the_spread_and_unknown_pixels_have_the_largest(estimate):
    mean, std = estimate
    matte = np.ones((24, 30), np.float32)
    half = np.full((24, 30), 0.5, np.float32)
    drawn = Prior(np.full_like(mean, 0.2), np.zeros_like(std), np.ones((24, 30), bool))
    prior = Prior(np.full_like(mean, 0.6), np.zeros_like(std), np.ones((24, 30), bool))
    combined = combine(drawn, half, prior, matte)
    np.testing.assert_allclose(combined.mean, 0.4, atol=1e-6)
    np.testing.assert_allclose(combined.std, 0.2, atol=1e-6)
    hole = prior.known.copy()
    hole[3:6, 3:6] = False
    filled = combine(drawn, 0 * half, Prior(prior.mean * hole, prior.std, hole), matte)
    np.testing.assert_allclose(filled.mean, 0.6, atol=1e-6)
    np.testing.assert_allclose(filled.std[:, 3:6, 3:6], 0.5)
    assert not filled.known[3:6, 3:6].any()


def test_only_patches_that_the_keyframe_does_not_cover_are_drawn(fake):
    rng = np.random.default_rng(1)
    rgb = rng.random((96, 128, 3), dtype=np.float32)
    matte = np.ones((96, 128), np.float32)
    whole = estimate_frame(rgb, matte, fake(), SETTINGS, 0, 1)
    known = np.ones((96, 128), bool)
    known[:, 100:] = False
    prior = Prior(np.full((2, 96, 128), 0.5, np.float32), np.full((2, 96, 128), 0.1, np.float32), known)
    partial = estimate_frame(rgb, matte, fake(), SETTINGS, 0, 1, prior)
    assert 0 < partial.total_nfe < 0.6 * whole.total_nfe
    assert not partial.nfe[:, :40].any()
    np.testing.assert_array_equal(partial.mean[:, :, :40], prior.mean[:, :, :40])
    np.testing.assert_allclose(partial.mean[:, :, 120:], whole.mean[:, :, 120:], atol=1e-6)
    everything = Prior(prior.mean, prior.std, np.ones_like(known))
    assert estimate_frame(rgb, matte, fake(), SETTINGS, 0, 1, everything).total_nfe == 0


def test_a_patch_is_drawn_if_less_than_the_given_fraction_is_covered(fake):
    rgb, matte = np.full((32, 32, 3), 0.5, np.float32), np.ones((32, 32), np.float32)
    known = np.arange(32)[None] < 16
    prior = Prior(np.full((2, 32, 32), 0.9, np.float32), np.zeros((2, 32, 32), np.float32), known.repeat(32, 0))
    spent = {
        share: estimate_frame(rgb, matte, fake(), EnsembleSettings(4, reuse_share=share), 0, 1, prior).total_nfe
        for share in (0.4, 0.5, 0.6)
    }
    assert spent == {0.4: 0, 0.5: 0, 0.6: 4 * 3}


@pytest.mark.parametrize("tolerance", [0.0, 1e-9])
def test_a_patch_that_is_drawn_takes_nothing_from_the_keyframe(fake, tolerance):
    """Also where the keyframe is known: a single patch has weight 1 everywhere, whatever the number of rounds."""
    rgb, matte = np.full((32, 32, 3), 0.5, np.float32), np.ones((32, 32), np.float32)
    settings = EnsembleSettings(4, tolerance=tolerance)
    known = (np.arange(32)[None] < 16).repeat(32, 0)
    prior = Prior(np.full((2, 32, 32), 0.9, np.float32), np.zeros((2, 32, 32), np.float32), known)
    alone, reused = (estimate_frame(rgb, matte, fake(), settings, 0, 1, p) for p in (None, prior))
    np.testing.assert_allclose(reused.mean, alone.mean, atol=1e-6)
    np.testing.assert_allclose(reused.std, alone.std, atol=1e-6)


def test_frames_that_cannot_reach_their_keyframe_are_drawn_in_full():
    frames = range(1001, 1009)
    assert keyframes_taken(frames, 3, set(), set()) == {1002: 1004, 1003: 1004, 1005: 1007, 1006: 1007}
    assert keyframes_taken(frames, 3, {1004}, set()) == {1005: 1007, 1006: 1007}, "the keyframe is dead"
    assert keyframes_taken(frames, 3, {1002}, set()) == {1003: 1004, 1005: 1007, 1006: 1007}, "a dead frame takes none"
    assert keyframes_taken(frames, 3, set(), {1003}) == {1005: 1007, 1006: 1007}, "no flow on the way"
    assert keyframes_taken(frames, 3, set(), {1004}) == keyframes_taken(frames, 3, set(), set()), "not on the way"


def test_the_soft_edge_of_the_matte_costs_no_draw(fake):
    rgb = np.full((64, 64, 3), 0.5, np.float32)
    matte = np.zeros((64, 64), np.float32)
    matte[20:40, 20:40] = 0.3
    matte[22:38, 22:38] = 1
    prior = Prior(np.full((2, 64, 64), 0.5, np.float32), np.zeros((2, 64, 64), np.float32), matte > 0.5)
    combined = estimate_frame(rgb, matte, fake(), SETTINGS, 0, 1, prior)
    assert combined.total_nfe == 0
    np.testing.assert_allclose(combined.mean[:, matte > 0], 0.5)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [({"keyframe_step": 0}, "keyframe_step"), ({"reuse_share": 1.5}, "reuse_share")],
)
def test_settings_without_meaning_are_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        EnsembleSettings(**arguments)
