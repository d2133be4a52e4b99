"""Material errors and calibration: closed forms."""

import math

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, spearmanr

from yesnt.metrics.material import area_under_curve, ause, measure_material, sparsification, spearman


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def test_a_perfect_estimate(rng):
    truth = rng.random(100)
    found = {m.name: m.value for m in measure_material(truth, truth, binary=True)}
    assert found["rmse"] == found["bias"] == 0
    assert found["auc"] == 1


def test_a_constant_offset_is_bias_and_rmse(rng):
    truth = rng.random(100)
    found = {m.name: m.value for m in measure_material(truth + 0.1, truth)}
    assert found["rmse"] == pytest.approx(0.1)
    assert found["bias"] == pytest.approx(0.1)


def test_auc_of_order_and_of_nothing():
    positive = np.array([False, False, True, True])
    assert area_under_curve(np.array([0.1, 0.2, 0.3, 0.4]), positive) == 1
    assert area_under_curve(-np.array([0.1, 0.2, 0.3, 0.4]), positive) == 0
    assert area_under_curve(np.zeros(4), positive) == 0.5
    assert math.isnan(area_under_curve(np.zeros(4), np.zeros(4, bool)))


def test_spearman_equals_scipys_and_says_when_there_is_none(rng):
    a, b = rng.random(200), rng.integers(0, 5, 200)
    assert spearman(a, b) == pytest.approx(spearmanr(a, b).statistic)
    assert math.isnan(spearman(np.ones(5), b[:5]))


def test_a_spread_that_orders_the_errors_has_no_area(rng):
    error = rng.normal(size=500)
    assert ause(error, np.abs(error)) == pytest.approx(0, abs=1e-12)
    assert ause(error, -np.abs(error)) > ause(error, rng.random(500)) > 0.1


def test_the_oracles_curve_falls(rng):
    error = rng.normal(size=500)
    assert (np.diff(sparsification(error, np.abs(error))) <= 0).all()


def test_auc_equals_scipys_mann_whitney(rng):
    score, positive = rng.integers(0, 9, 300).astype(float), rng.random(300) < 0.3
    theirs = mannwhitneyu(score[positive], score[~positive]).statistic / (positive.sum() * (~positive).sum())
    assert area_under_curve(score, positive) == pytest.approx(theirs)


def test_sparsification_equals_its_words(rng):
    error, std = rng.normal(size=200), rng.random(200)
    for share, value in zip(np.linspace(1, 0.05, 20), sparsification(error, std), strict=True):
        kept = sorted(range(200), key=lambda i: std[i])[: round(share * 200)]
        assert value == pytest.approx(math.sqrt(sum(error[i] ** 2 for i in kept) / len(kept)))
