"""All numbers of one picture."""

import math

import numpy as np
import pytest

from yesnt.metrics.definitions import DEFINITIONS
from yesnt.metrics.score import Truth, score


@pytest.fixture
def truth():
    rng = np.random.default_rng(10)
    radiance = (rng.random((10, 10, 3)) ** 3 * 4).repeat(5, 0).repeat(5, 1).astype(np.float32)
    opacity = np.zeros((50, 50), np.float32)
    opacity[8:42, 10:40] = 1
    return Truth.of(radiance, opacity, opacity)


def values(radiance, truth):
    return {metric.name: metric.value for metric in score(radiance, truth)}


def test_the_truth_itself_is_perfect(truth):
    found = values(truth.radiance, truth)
    assert found["psnr"] == found["psnr_whole"] == found["psnr_linear"] == math.inf
    assert found["ssim"] == pytest.approx(1)
    assert found["flip"] == found["hdr_flip"] == 0


def test_what_lies_outside_the_matte_does_not_count(truth):
    outside = truth.opacity == 0
    wrecked = np.where(outside[..., None], 50, truth.radiance * 0.9)
    assert values(wrecked, truth) == values(truth.radiance * 0.9, truth)


def test_alignment_forgives_an_exposure(truth):
    found = values(truth.radiance * np.float32([2, 0.5, 1.5]), truth)
    assert found["psnr"] < 20 < 60 < found["psnr_aligned"]


def test_every_number_has_its_definition(truth):
    found = score(truth.radiance, truth)
    assert all(metric.definition == DEFINITIONS[metric.name].text for metric in found)
    assert len({metric.name for metric in found}) == len(found)


def test_whole_frame_numbers_do_not_depend_on_the_cut(truth):
    from yesnt.metrics.flip import flip_map
    from yesnt.metrics.image import psnr, ssim_map

    opacity = np.pad(truth.opacity, 60)
    wide = Truth.of(np.pad(truth.radiance, ((60, 60), (60, 60), (0, 0))), opacity, opacity)
    picture = wide.radiance * np.float32(0.8)
    found, shown = values(picture, wide), wide.shown(picture)
    assert wide.frame[0].stop - wide.frame[0].start < shown.shape[0]
    assert found["psnr_whole"] == pytest.approx(psnr(shown, wide.display))
    assert found["ssim_whole"] == pytest.approx(ssim_map(shown, wide.display).mean())
    assert found["flip_whole"] == pytest.approx(flip_map(shown, wide.display).mean())
