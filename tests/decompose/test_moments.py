"""Running moments against NumPy's sums over all members."""

import numpy as np
import pytest

from yesnt.decompose.moments import Moments


@pytest.fixture
def members():
    rng = np.random.default_rng(0)
    values = rng.random((6, 2, 5, 7), dtype=np.float32)
    weights = rng.random((6, 5, 7), dtype=np.float32)
    weights[:, 0] = 0  # a row that no patch covers
    weights[:, 1] = 1
    moments = Moments(5, 7)
    for value, weight in zip(values, weights, strict=True):
        moments.update(value, weight)
    return values, weights[:, None], moments


def test_weighted_mean_and_population_std(members):
    values, weights, moments = members
    total = weights.sum(0)
    safe = np.where(total > 0, total, 1)
    mean = (weights * values).sum(0) / safe
    std = np.sqrt((weights * (values - mean) ** 2).sum(0) / safe)
    np.testing.assert_allclose(moments.weight, total[0], rtol=1e-6)
    np.testing.assert_allclose(moments.mean, mean, atol=1e-6)
    np.testing.assert_allclose(moments.std(), std, atol=1e-6)
    assert not moments.std()[:, 0].any()


def test_standard_error_of_independent_members_loses_a_degree_of_freedom(members):
    values, _, moments = members
    sample_std = values[:, :, 1].std(axis=0, ddof=1)
    np.testing.assert_allclose(moments.standard_error(antithetic=False)[:, 1], sample_std / np.sqrt(6), rtol=1e-5)


def test_standard_error_of_antithetic_members_loses_none(members):
    values, _, moments = members
    population_std = values[:, :, 1].std(axis=0)
    np.testing.assert_allclose(moments.standard_error(antithetic=True)[:, 1], population_std / np.sqrt(6), rtol=1e-5)


def test_a_predicted_mean_has_no_error_and_leaves_the_spread(members):
    _, _, moments = members
    std = moments.std()
    predicted = np.full((2, 5, 7), 0.25, np.float32)
    moments.set_mean(predicted)
    np.testing.assert_array_equal(moments.mean, predicted)
    np.testing.assert_array_equal(moments.std(), std)
    assert not moments.standard_error(antithetic=False).any()
