"""Perceptual distance: laws on random weights, then the published ones of the extra `metrics`."""

import numpy as np
import pytest
import torch

from yesnt.core.errors import CorruptError
from yesnt.measure.evaluation.nets import open_nets
from yesnt.metrics.perceptual import PerceptualNet

SHAPES = ((64, 3, 11), (192, 64, 5), (384, 192, 3), (256, 384, 3), (256, 256, 3))
NAMES = {
    "stlpips": ("net.slice1.0", "net.slice2.5", "net.slice3.9", "net.slice4.11", "net.slice5.13"),
    "lpips": ("net.slice1.0", "net.slice2.3", "net.slice3.6", "net.slice4.8", "net.slice5.10"),
}


def random_state(kind):
    generator = torch.Generator().manual_seed(0)
    state = {}
    for i, (name, (out, into, size)) in enumerate(zip(NAMES[kind], SHAPES, strict=True)):
        state[f"{name}.weight"] = torch.randn(out, into, size, size, generator=generator) / (into * size**2) ** 0.5
        state[f"{name}.bias"] = torch.zeros(out)
        state[f"lin{i}.model.1.weight"] = torch.rand(1, out, 1, 1, generator=generator)
    return state


@pytest.fixture(scope="module", params=("stlpips", "lpips"))
def net(request):
    made = PerceptualNet(random_state(request.param))
    assert made.name == request.param
    return made


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(5).random((6, 7, 3)).repeat(8, 0).repeat(8, 1)


def test_identity_and_symmetry(net, picture):
    other = np.clip(picture + 0.1, 0, 1)
    assert net.distance(picture, picture) == 0
    assert net.distance(picture, other) == pytest.approx(net.distance(other, picture), rel=1e-5)


def test_more_noise_is_farther(net, picture):
    noise = np.random.default_rng(6).normal(0, 1, picture.shape)
    near, far = (net.distance(picture, np.clip(picture + s * noise, 0, 1)) for s in (0.02, 0.3))
    assert 0 < near < far


@pytest.fixture(scope="module")
def noisy():
    """The pair of pictures that the authors' own code was run on."""
    first = np.random.default_rng(5).random((12, 9, 3)).repeat(8, 0).repeat(8, 1)
    return first, np.clip(first + np.random.default_rng(6).normal(0, 0.1, first.shape), 0, 1)


@pytest.fixture(scope="module")
def published():
    """The network with the weights of the extra `metrics`."""
    return open_nets(None)[0]


AUTHORS = {"lpips": 0.11891353875398636, "stlpips": 0.016416270285844803}
"""What lpips 0.1.4 and stlpips-pytorch 0.0.2 themselves give for the pair with the weights of `random_state`."""


def test_equals_the_authors_implementation(net, noisy):
    assert net.distance(*noisy) == pytest.approx(AUTHORS[net.name], rel=1e-5)


def test_published_weights_give_the_authors_number(published, noisy):
    assert published.name == "stlpips"
    assert published.distance(*noisy) == pytest.approx(0.04366084188222885, rel=1e-5)


@pytest.mark.parametrize("size", [(9, 12), (40, 20), (31, 32)])
def test_small_pictures_are_padded_with_black_at_the_bottom_and_right(net, picture, size):
    height, width = size
    small, other = picture[:height, :width], 1 - picture[:height, :width]
    pad = ((0, max(0, 32 - height)), (0, max(0, 32 - width)), (0, 0))
    by_hand = np.pad(small, pad), np.pad(other, pad)
    assert net.distance(small, other) == net.distance(*by_hand)
    assert [f.shape for f in net.features(small)] == [f.shape for f in net.features(by_hand[0])]
    white = np.pad(small, pad, constant_values=1), np.pad(other, pad, constant_values=1)
    assert net.distance(small, other) != pytest.approx(net.distance(*white), rel=1e-3)


@pytest.mark.parametrize(("size", "padded"), [((9, 12), (32, 32)), ((40, 20), (40, 32)), ((48, 56), (48, 56))])
def test_only_sides_below_32_are_padded(net, picture, size, padded):
    """The first layer's size follows from the padded sides: window 11, padding 2, then stride 4 or a low-pass."""

    def first_layer(side):
        dense = side + 2 * 2 - 11
        return (dense + 1 + 2 * 2 - 3) // 2 + 1 if net.name == "stlpips" else dense // 4 + 1

    found = net.features(picture[: size[0], : size[1]])[0].shape[2:]
    assert tuple(found) == tuple(first_layer(side) for side in padded)


def test_other_weights_are_refused():
    with pytest.raises(CorruptError, match="not LPIPS or ST-LPIPS"):
        PerceptualNet({"conv.weight": torch.zeros(1)})


def test_published_weights_forgive_a_shift_and_not_noise(published, picture):
    shifted, noisy = (
        np.roll(picture, 1, 1),
        np.clip(picture + np.random.default_rng(7).normal(0, 0.3, picture.shape), 0, 1),
    )
    assert published.distance(picture, shifted) < 0.25 * published.distance(picture, noisy)
