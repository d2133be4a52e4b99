"""Measured materials on frames between those that are measured."""

from __future__ import annotations

import numpy as np

from yesnt.decompose.evidence.carry import carried_evidence
from yesnt.decompose.evidence.records import FrameEvidence
from yesnt.decompose.reuse import Link
from yesnt.decompose.settings import EnsembleSettings

SIZE = (6, 8)


def planes(roughness: float, metallic: float) -> np.ndarray:
    return np.stack([np.full(SIZE, value, np.float32) for value in (roughness, metallic)])


def carried(spread: float, validity: np.ndarray) -> FrameEvidence:
    """A keyframe of metal with this spread, taken to a frame in which the model is sure of plastic."""
    measured = FrameEvidence(planes(0.3, 0.8), planes(spread, spread), np.full(SIZE, 5, np.float32), {}, {})
    own, flow = (planes(0.6, 0.1), planes(0.03, 0.03)), np.zeros((*SIZE, 2), np.float32)
    inside = np.ones(SIZE, bool)
    return carried_evidence(measured, own, ([Link(flow, validity)], [inside, inside]), EnsembleSettings(), 2)


def test_what_is_measured_is_carried_however_uncertain_it_is() -> None:
    for spread in (0.05, 0.24, 0.26, 0.5):
        found = carried(spread, np.ones(SIZE, np.float32))
        assert np.allclose(found.mean, planes(0.3, 0.8), atol=1e-5), spread
        assert np.allclose(found.std, spread, atol=1e-5)
        assert (found.views == 5).all()


def test_the_model_stands_where_the_flow_is_not_valid() -> None:
    validity = np.ones(SIZE, np.float32)
    validity[:, :3] = 0.4
    found = carried(0.1, validity)
    assert np.allclose(found.mean[:, :, :3], planes(0.6, 0.1)[:, :, :3])
    assert np.allclose(found.mean[:, :, 3:], planes(0.3, 0.8)[:, :, 3:], atol=1e-5)
    assert not found.views[:, :3].any()
