"""FLIP: laws, then NVIDIA's implementation."""

import numpy as np
import pytest

from yesnt.metrics.flip import exposure_range, flip_map, hdr_flip_map


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    base = rng.random((8, 10, 3)).repeat(8, 0).repeat(8, 1).astype(np.float32)
    return base, np.clip(base + rng.normal(0, 0.1, base.shape), 0, 1).astype(np.float32)


def test_identical_pictures_have_no_error(pair):
    base, _ = pair
    assert flip_map(base, base).max() == 0


def test_symmetric_and_within_the_unit_range(pair):
    a, b = pair
    np.testing.assert_allclose(flip_map(a, b), flip_map(b, a), atol=1e-12)
    assert 0 <= flip_map(a, b).min() <= flip_map(a, b).max() <= 1


def test_green_against_blue_is_the_largest_colour_error():
    green, blue = (np.tile(np.float32(c), (32, 32, 1)) for c in ((0, 1, 0), (0, 0, 1)))
    np.testing.assert_allclose(flip_map(green, blue), 1, atol=1e-9)


def test_more_noise_is_worse(pair):
    base, _ = pair
    noise = np.random.default_rng(4).normal(0, 1, base.shape)
    means = [flip_map(np.clip(base + s * noise, 0, 1), base).mean() for s in (0.01, 0.05, 0.2)]
    assert means[0] < means[1] < means[2]


def test_ldr_equals_nvidias(pair):
    flip_evaluator = pytest.importorskip("flip_evaluator")
    a, b = pair
    theirs, _, _ = flip_evaluator.evaluate(a, b, "LDR", applyMagma=False)
    np.testing.assert_allclose(flip_map(b, a), theirs.squeeze(), atol=1e-4)  # theirs is float32


def test_hdr_equals_nvidias_exposures_included(pair):
    flip_evaluator = pytest.importorskip("flip_evaluator")
    truth = (pair[0] ** 4 * 30 + 0.01).astype(np.float32)
    other = (truth * 1.3 + 0.05 * pair[1]).astype(np.float32)
    theirs, _, used = flip_evaluator.evaluate(truth, other, "HDR", applyMagma=False)
    exposures = exposure_range(truth)
    assert exposures[0] == pytest.approx(used["startExposure"], abs=1e-4)
    assert exposures[-1] == pytest.approx(used["stopExposure"], abs=1e-4)
    assert len(exposures) == used["numExposures"]
    np.testing.assert_allclose(hdr_flip_map(other, truth, exposures), theirs.squeeze(), atol=1e-4)
