"""Overrides of observed materials: arrays in, arrays out."""

from __future__ import annotations

import numpy as np
import pytest

from yesnt.core.material_input import Scale
from yesnt.decompose.corrections import Override, correct, share_of_subject

ROUGHNESS, METALLIC = 0, 1
SHAPE = (2, 3)
MEAN = np.full((2, *SHAPE), 0.4, np.float32)
SPREAD = np.full((2, *SHAPE), 0.2, np.float32)


def weight(value: float) -> np.ndarray:
    """A weight in the first column, 0 elsewhere."""
    plane = np.zeros(SHAPE, np.float32)
    plane[:, 0] = value
    return plane


def test_a_given_value_is_certain_and_touches_nothing_else() -> None:
    found = correct(MEAN, SPREAD, [Override(METALLIC, 1.0, weight(1))])
    assert found.mean[METALLIC].tolist() == [[1, pytest.approx(0.4), pytest.approx(0.4)]] * 2
    assert found.spread[METALLIC].tolist() == [[0, pytest.approx(0.2), pytest.approx(0.2)]] * 2
    np.testing.assert_array_equal(found.certain[METALLIC], weight(1))
    np.testing.assert_array_equal((found.mean[ROUGHNESS], found.spread[ROUGHNESS]), (MEAN[0], SPREAD[0]))
    assert not found.certain[ROUGHNESS].any()
    assert MEAN.min() == MEAN.max(), "the observation itself is not changed"


def test_half_a_mask_mixes() -> None:
    found = correct(MEAN, SPREAD, [Override(ROUGHNESS, 0.8, weight(0.5))])
    np.testing.assert_allclose((found.mean[0, 0, 0], found.spread[0, 0, 0], found.certain[0, 0, 0]), (0.6, 0.1, 0.5))


def test_a_factor_scales_value_and_spread_and_counts_what_leaves_the_range() -> None:
    found = correct(MEAN, SPREAD, [Override(ROUGHNESS, Scale(scale=1.5), weight(1))])
    np.testing.assert_allclose((found.mean[0, 0, 0], found.spread[0, 0, 0]), (0.6, 0.3), rtol=1e-6)
    assert (found.clamped, float(found.certain.max())) == (0, 0)
    found = correct(MEAN, SPREAD, [Override(ROUGHNESS, Scale(scale=3), weight(1))])
    assert (found.mean[0, 0, 0], found.spread[0, 0, 0], found.clamped) == (1, 0.5, 2)


def test_a_later_override_changes_what_an_earlier_one_left() -> None:
    value, factor = Override(ROUGHNESS, 0.8, weight(1)), Override(ROUGHNESS, Scale(scale=0.5), weight(1))
    np.testing.assert_allclose(correct(MEAN, SPREAD, [value, factor]).mean[0, 0, 0], 0.4, rtol=1e-6)
    np.testing.assert_allclose(correct(MEAN, SPREAD, [factor, value]).mean[0, 0, 0], 0.8, rtol=1e-6)


def test_a_pass_gives_each_pixel_its_own_value() -> None:
    plane = np.linspace(0, 1, 6, dtype=np.float32).reshape(SHAPE)
    found = correct(MEAN, SPREAD, [Override(ROUGHNESS, plane, np.ones(SHAPE, np.float32))])
    np.testing.assert_allclose(found.mean[0], plane, atol=1e-7)
    assert not found.spread[0].any()


def test_at_the_subjects_edge_a_mask_counts_by_its_share_of_the_subject() -> None:
    coverage = np.array([[1, 0.5, 0.25, 0.2, 0.3, 0.0]], np.float32)
    matte = np.array([[1, 0.5, 0.50, 0.1, 0.0, 0.5]], np.float32)
    np.testing.assert_allclose(share_of_subject(coverage, matte), [[1, 1, 0.5, 1, 0, 0]])
