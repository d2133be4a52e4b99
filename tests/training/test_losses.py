"""The losses against their formulas written out in NumPy."""

import numpy as np
import pytest
import torch

from yesnt.training.losses import context_loss, energy_score, estimator_loss


def pooled(plane, size):
    """Block means [B, C, P/size, P/size]."""
    rows, channels, side, _ = plane.shape
    return plane.reshape(rows, channels, side // size, size, side // size, size).mean((3, 5))


def cross_entropy(scores, kind, importance):
    """Mean over the labelled pixels, weighted by class; scores [B, K, h, w], kind [B, h, w]."""
    log = scores - np.log(np.exp(scores).sum(1, keepdims=True))
    inside = kind >= 0
    picked = np.take_along_axis(log, np.maximum(kind, 0)[:, None], 1)[:, 0]
    weight = importance[np.maximum(kind, 0)] * inside
    return -(picked * weight).sum() / weight.sum()


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_energy_score_sums_four_windows(rng):
    first, second, clean = rng.random((3, 2, 2, 32, 32))
    matte = (rng.random((2, 1, 32, 32)) > 0.4) * rng.random((2, 1, 32, 32))
    expected = 0.0
    for size, weight in ((1, 1.0), (4, 0.5), (16, 0.5), (32, 0.3)):
        cover = pooled(matte, size)
        a, b, y = (pooled(x * matte, size) / np.maximum(cover, 1e-3) for x in (first, second, clean))
        score = 0.5 * (abs(a - y) + abs(b - y)) - 0.5 * abs(a - b)
        expected += weight * (score * cover).sum() / (2 * cover.sum())
    found = energy_score(*(torch.from_numpy(x) for x in (first, second, clean, matte)))
    assert float(found) == pytest.approx(expected, rel=1e-6)


def test_estimator_loss_weights_means_by_coverage_and_ignores_the_outside(rng):
    condition, classes = rng.normal(size=(2, 5, 4, 4)), rng.normal(size=(2, 3, 4, 4))
    clean, kind = rng.uniform(-1, 1, (2, 2, 8, 8)), rng.integers(-1, 3, (2, 8, 8))
    weights, importance = rng.random((2, 1, 8, 8)), np.array([1.0, 0.3, 2.0])
    cover = pooled(weights, 2)
    mean = pooled(clean * weights, 2) / np.maximum(cover, 1e-3)
    square = ((condition[:, :2] - mean) ** 2 * cover).sum() / (2 * cover.sum())
    expected = square + 0.1 * cross_entropy(classes, kind[:, ::2, ::2], importance)
    arrays = (condition, classes, clean, kind, weights, importance)
    assert float(estimator_loss(*(torch.from_numpy(x) for x in arrays))) == pytest.approx(expected, rel=1e-6)


def test_context_loss_compares_with_the_truth_in_minus_one_to_one(rng):
    scores, truth = rng.normal(size=(2, 5, 4, 4)), rng.random((2, 3, 4, 4))
    kind, importance = rng.integers(-1, 3, (2, 4, 4)), np.array([1.0, 0.3, 2.0])
    cover = truth[:, 2:] * importance[np.maximum(kind, 0)][:, None]
    square = ((scores[:, :2] - (2 * truth[:, :2] - 1)) ** 2 * cover).sum() / (2 * cover.sum())
    expected = square + 0.1 * cross_entropy(scores[:, 2:], kind, importance)
    found = context_loss(*(torch.from_numpy(x) for x in (scores, truth, kind, importance)))
    assert float(found) == pytest.approx(expected, rel=1e-6)
