"""Inconsistent frames and members: found, named, and kept from their neighbours."""

import numpy as np
import pytest

from yesnt.temporal import OUTLIER_HALO, bridged_links, consistent_members, robust_confidence, solve, solve_bridged


@pytest.fixture(scope="module")
def sequence(pattern):
    return pattern(30, 40, 48, noise=0.04)


CORRUPTED = (4, 13, 25)


def corrupt(problem, kind):
    """10 % of the frames replaced."""
    rng = np.random.default_rng(5)
    observed = problem.observed.copy()
    for t in CORRUPTED:
        if kind == "offset":
            observed[t] += 0.3
        elif kind == "inverted":
            observed[t] = 1 - observed[t]
        else:
            observed[t] = rng.random(observed[t].shape)
    return problem.changed(observed=observed)


def clean_error(problem, value):
    clean = np.setdiff1d(np.arange(30), CORRUPTED)
    return np.sqrt(np.mean((value - problem.truth)[clean][problem.matte[clean]] ** 2))


@pytest.mark.parametrize("kind", ["offset", "inverted", "noise"])
def test_corrupted_frames_are_named_and_spoil_nothing_else(sequence, kind):
    broken = corrupt(sequence, kind)
    confidence, report = robust_confidence(*broken.arguments[:4], broken.matte)
    assert report.frames == CORRUPTED
    without = sequence.confidence.copy()
    without[list(CORRUPTED)] = 0
    error = {
        "uncorrupted": clean_error(sequence, solve(*sequence.arguments).value),
        "plain": clean_error(sequence, solve(*broken.arguments).value),
        "robust": clean_error(sequence, solve(*broken.changed(confidence=confidence).arguments).value),
        "told": clean_error(sequence, solve(*broken.changed(confidence=without).arguments).value),
    }
    assert error["robust"] < 1.02 * error["told"]
    assert error["robust"] < 1.06 * error["uncorrupted"]
    assert error["robust"] < error["plain"]


def test_a_clean_sequence_keeps_its_confidence(sequence):
    confidence, report = robust_confidence(*sequence.arguments[:4], sequence.matte)
    assert report.frames == ()
    assert np.mean(confidence[sequence.matte] < 0.9 * sequence.confidence[sequence.matte]) < 0.01


def test_an_inconsistent_region_loses_confidence_there_only(sequence):
    observed = sequence.observed.copy()
    observed[10, 10:26, 16:32] += 0.4
    confidence, report = robust_confidence(observed, *sequence.arguments[1:4], sequence.matte)
    change = confidence / np.maximum(sequence.confidence, 1e-6)
    inside = np.zeros_like(sequence.matte)
    inside[10, 13:23, 19:29] = True
    assert change[inside & sequence.matte].max() < 0.5
    assert np.median(change[10][sequence.matte[10] & (np.arange(40)[:, None] > 33)]) > 0.9
    assert report.downweighted[10] > 0.1


def test_blocks_with_halo_give_the_same_confidence(sequence):
    broken = corrupt(sequence, "offset")
    whole, _ = robust_confidence(*broken.arguments[:4], broken.matte)
    core = slice(10, 18)
    outer = slice(core.start - OUTLIER_HALO, core.stop + OUTLIER_HALO)
    part = broken.cut(outer)
    block, _ = robust_confidence(*part[:4], part[5])
    np.testing.assert_array_equal(block[OUTLIER_HALO:-OUTLIER_HALO], whole[core])


def test_one_and_two_frames_have_no_outliers(sequence):
    for frames in (1, 2):
        part = sequence.cut(slice(0, frames))
        confidence, report = robust_confidence(*part[:4], part[5])
        np.testing.assert_array_equal(confidence, part[1])
        assert report.frames == ()


def test_a_member_that_disagrees_is_left_out():
    rng = np.random.default_rng(0)
    members = 0.5 + 0.02 * rng.standard_normal((6, 20, 20))
    members[4] = 0.9 - members[4]
    kept, distance = consistent_members(members, np.ones((20, 20), bool))
    assert kept.tolist() == [True, True, True, True, False, True]
    assert distance.argmax() == 4


def test_two_members_cannot_outvote_one_another():
    kept, _ = consistent_members(np.stack([np.zeros((4, 4)), np.ones((4, 4))]), np.ones((4, 4), bool))
    assert kept.all()
    assert consistent_members(np.zeros((3, 4, 4)), np.zeros((4, 4), bool))[0].all()


def test_sure_links_around_an_inconsistent_frame_count_twice_doubtful_ones_less(sequence):
    links = bridged_links(sequence.validity, (0, 4, 5, 29))
    doubled = [t for t in range(29) if (links[t] == 2 * sequence.validity[t] ** 2).all()]
    assert doubled == [0, 3, 4, 5, 28]
    kept = np.setdiff1d(np.arange(29), doubled)
    np.testing.assert_array_equal(links[kept], sequence.validity[kept])


def test_bridges_couple_what_lies_beside_an_inconsistent_frame_like_neighbours(sequence):
    """Without a spatial term and data at the middle frame, two doubled links in series are one link of weight 1."""
    from yesnt.temporal import EnergyParams

    params = EnergyParams(delta=10.0, lambda1=0.0, lambda2=1.0)
    observed = np.zeros((3, 4, 5), np.float32)
    observed[2] = 1
    confidence, still = np.ones_like(observed), np.zeros((2, 4, 5, 2), np.float32)
    confidence[1] = 0
    links = bridged_links(np.ones((2, 4, 5)), (1,))
    bridged = solve(observed, confidence, still, links, params, tolerance=1e-8).value[[0, 2]]
    direct = solve(observed[[0, 2]], confidence[[0, 2]], still[:1], links[:1] / 2, params, tolerance=1e-8).value
    np.testing.assert_allclose(bridged, direct, atol=1e-4)


def test_an_inconsistent_frame_has_no_spatial_term_where_links_hold_it(sequence):
    """Without data the total variation would flatten it, and it would pull at its neighbours."""
    without_data = sequence.confidence.copy()
    without_data[list(CORRUPTED)] = 0
    arguments = sequence.changed(confidence=without_data).arguments
    base = clean_error(sequence, solve(*sequence.arguments).value)
    flattened = clean_error(sequence, solve(*arguments).value)
    observed, confidence, flow, validity, params, matte = arguments
    held = clean_error(sequence, solve_bridged(observed, confidence, flow, validity, CORRUPTED, params, matte).value)
    assert held < flattened
    assert held < 1.02 * base
