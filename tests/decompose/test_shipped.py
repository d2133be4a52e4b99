"""The weights in the package, evaluated on the ground truth of the embedded shot."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import mannwhitneyu, spearmanr

from yesnt.core.color import straighten
from yesnt.decompose.auxiliary import AUXILIARY_INPUT_SIDE
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.registry import EMBEDDED_WEIGHTS
from yesnt.decompose.settings import EnsembleSettings
from yesnt.io.pictures.image import read_image

SHOT = Path(__file__).parents[2] / "yesnt" / "data" / "shot"


@pytest.fixture(scope="module")
def frame():
    """Number, straight rgb, matte and ground truth [H, W, 2] of a middle frame."""
    plates = sorted(SHOT.glob("plate.*.exr"))
    path = plates[len(plates) // 2]
    number = path.name.split(".")[1]
    plate = read_image(path).stack("RGBA")
    (material,) = SHOT.rglob(f"material.{number}.exr")
    truth = read_image(material).stack(["roughness.Y", "metallic.Y"])
    return int(number), straighten(plate[..., :3], plate[..., 3]), plate[..., 3], truth


@pytest.fixture(scope="module")
def estimate(frame):
    number, rgb, matte, _ = frame
    return estimate_frame(rgb, matte, EmbeddedBackend(), EnsembleSettings(8), 0, number)


@pytest.fixture(scope="module")
def evaluated(frame, estimate):
    """Truth, mean and std [2, n] inside the matte."""
    _, _, matte, truth = frame
    inside = matte > 0.99
    return truth[inside].T, estimate.mean[:, inside], estimate.std[:, inside]


def test_weights_and_code_belong_together(frame):
    """Values recorded with these weights and two steps: a change of any layer, input feature or step shows here."""
    number, rgb, matte, _ = frame
    estimate = estimate_frame(rgb, matte, EmbeddedBackend(steps=2), EnsembleSettings(8), 0, number)
    mean, std = estimate.mean[:, matte > 0.99], estimate.std[:, matte > 0.99]
    np.testing.assert_allclose(mean.mean(1), [0.60873, 0.10674], atol=2e-4)
    np.testing.assert_allclose(std.mean(1), [0.16205, 0.07636], atol=2e-4)
    recorded = {
        (26, 121): (0.4965, 0.0162, 0.0966, 0.0452),
        (47, 140): (0.4833, 0.0206, 0.1218, 0.0310),
        (74, 146): (0.4767, 0.0062, 0.1737, 0.0083),
        (86, 102): (0.4803, 0.3661, 0.2125, 0.3310),
        (94, 86): (0.5354, 0.3774, 0.1745, 0.3557),
    }
    found = {(y, x): (*estimate.mean[:, y, x], *estimate.std[:, y, x]) for y, x in recorded}
    for pixel, values in recorded.items():
        np.testing.assert_allclose(found[pixel], values, atol=2e-3, err_msg=str(pixel))


def test_weights_are_small():
    assert EMBEDDED_WEIGHTS.stat().st_size <= 10 << 20


def test_they_hold_an_auxiliary_predictor():
    assert EmbeddedBackend().auxiliary_side == AUXILIARY_INPUT_SIDE


def test_threads_do_not_change_a_bit(context):
    backend, generator = EmbeddedBackend(), torch.Generator().manual_seed(0)
    rgb, matte = torch.rand(8, 3, 128, 128, generator=generator), torch.ones(8, 1, 128, 128)
    whole = torch.rand(1, 4, AUXILIARY_INPUT_SIDE, AUXILIARY_INPUT_SIDE, generator=generator)
    noise = torch.randn(8, len(backend.noise_sigmas), 128, 128, generator=generator)
    threads, draws = torch.get_num_threads(), []
    try:
        for number in (1, 2):
            torch.set_num_threads(number)
            placed = context(8)._replace(auxiliary=backend.predict_auxiliary(whole).expand(8, -1, -1, -1))
            draws.append(backend.sample(backend.encode(rgb, matte, placed), noise))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(*draws)


def test_roughness_beats_the_best_constant(evaluated):
    truth, mean, _ = evaluated
    error = np.sqrt(np.mean((mean[0] - truth[0]) ** 2))
    assert error < 0.985 * truth[0].std()


def test_metal_is_distinguished_from_the_rest(evaluated):
    truth, mean, _ = evaluated
    metal = truth[1] > 0.5
    assert mean[1][metal].mean() > 2 * mean[1][~metal].mean()
    ranks = mannwhitneyu(mean[1][metal], mean[1][~metal]).statistic
    assert ranks / (metal.sum() * (~metal).sum()) > 0.9  # area under the curve


def test_spread_is_larger_where_the_error_is(evaluated):
    truth, mean, std = evaluated
    roughness, metallic = (spearmanr(std[plane], np.abs(mean - truth)[plane]).statistic for plane in (0, 1))
    assert roughness > 0.1
    assert metallic > 0.5
