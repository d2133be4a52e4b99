"""Measured materials on frames between those that are measured."""

from __future__ import annotations

import numpy as np

from yesnt.decompose.evidence.carry import carried_evidence
from yesnt.decompose.evidence.fill import NEAR, REACH, mixture
from yesnt.decompose.evidence.records import FrameEvidence
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.reuse import Link
from yesnt.decompose.settings import EnsembleSettings

SIZE = (6, 8)


def planes(roughness: float, metallic: float) -> np.ndarray:
    return np.stack([np.full(SIZE, value, np.float32) for value in (roughness, metallic)])


def carried(spread: float, validity: np.ndarray, plate: np.ndarray | None = None) -> FrameEvidence:
    """A keyframe of metal with this spread, taken to a frame in which the model is sure of plastic."""
    measured = FrameEvidence(planes(0.3, 0.8), planes(spread, spread), np.full(SIZE, 5, np.float32), {}, {})
    own, flow = (planes(0.6, 0.1), planes(0.03, 0.03)), np.zeros((*SIZE, 2), np.float32)
    inside, plate = np.ones(SIZE, bool), np.full((*SIZE, 3), 0.5, np.float32) if plate is None else plate
    way = [Link(flow, validity)], [inside, inside]
    return carried_evidence(measured, own, way, EnsembleSettings(), plate, EvidenceSettings())


def test_what_is_measured_is_carried_however_uncertain_it_is() -> None:
    for spread in (0.05, 0.24, 0.26, 0.5):
        found = carried(spread, np.ones(SIZE, np.float32))
        assert np.allclose(found.mean, planes(0.3, 0.8), atol=1e-5), spread
        assert np.allclose(found.std, spread, atol=1e-5)
        assert (found.views == 5).all()


def test_pixels_that_the_flow_does_not_reach_follow_measured_ones_of_their_colour() -> None:
    validity = np.ones(SIZE, np.float32)
    validity[:, :3] = 0.4
    found = carried(0.1, validity)
    assert np.allclose(found.mean[:, :, 3:], planes(0.3, 0.8)[:, :, 3:], atol=1e-5)
    assert not found.views[:, :3].any(), "no camera measured them"
    beside = found.mean[:, :, 2]
    assert (beside[0] < 0.33).all()
    assert (beside[1] > 0.7).all()
    assert (found.std[:, :, 2] > 0.1).all()
    assert (found.std[:, :, 0] > found.std[:, :, 2]).all(), "the farther, the less is known"


def test_the_model_stands_where_nothing_measured_looks_alike_and_its_own_error_counts() -> None:
    validity, plate = np.ones(SIZE, np.float32), np.full((*SIZE, 3), 0.5, np.float32)
    validity[:, :3] = 0.4
    plate[:, :3] = 0.9, 0.1, 0.1
    found = carried(0.1, validity, plate)
    assert np.allclose(found.mean[:, :, :3], planes(0.6, 0.1)[:, :, :3], atol=1e-3)
    np.testing.assert_allclose(found.std[0, :, :3], np.hypot(0.03, EvidenceSettings().roughness_error), atol=1e-3)
    np.testing.assert_allclose(found.std[1, :, :3], 0.5, atol=1e-3, err_msg="the largest of a value in 0 to 1")


def test_nothing_is_filled_where_nothing_was_measured() -> None:
    found = carried(0.1, np.zeros(SIZE, np.float32))
    np.testing.assert_array_equal(found.mean, planes(0.6, 0.1))
    np.testing.assert_array_equal(found.std, planes(0.03, 0.03))


def test_a_mixture_has_the_mean_and_deviation_of_its_draws() -> None:
    rng = np.random.default_rng(0)
    weight, others = np.array([[0.5, 0.2]]), (np.array([[0.4, 0.7]]), np.array([[0.05, 0.1]]))
    mean, std = mixture((np.array([0.2]), np.array([0.15])), others, weight)
    kind = rng.choice(3, 200_000, p=[0.5, 0.2, 0.3])
    drawn = rng.normal(np.array([0.4, 0.7, 0.2])[kind], np.array([0.05, 0.1, 0.15])[kind])
    assert abs(mean[0] - drawn.mean()) < 2e-3
    assert abs(std[0] - drawn.std()) < 2e-3
    assert NEAR * REACH < 1, "a subject's farther side does not count"
