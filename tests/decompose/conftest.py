"""Backends without a network, for tests of blending and sampling."""

import pytest
import torch

from yesnt.decompose.global_context import CONTEXT_SIDE, ContextBatch


class FakeBackend:
    """Roughness is the red channel plus noise, metallic is the matte."""

    patch = 32
    align = 1
    batch = 4
    noise_sigmas = (0.0, 6.0)
    nfe = 3

    def __init__(self, noise_gain=0.1, batch=4, patch=32):
        self.noise_gain, self.batch, self.patch = noise_gain, batch, patch
        self.sampled = 0

    def encode(self, rgb, matte, context):
        assert context.image.shape[0] == context.location.shape[0] == self.batch
        assert rgb.shape == (self.batch, 3, self.patch, self.patch)
        assert matte.shape == (self.batch, 1, self.patch, self.patch)
        return torch.cat([rgb[:, :1], matte], 1)

    def sample(self, condition, noise):
        self.sampled += 1
        assert noise.shape == (self.batch, len(self.noise_sigmas), self.patch, self.patch)
        return torch.cat([condition[:, :1] + self.noise_gain * noise[:, 1:2], condition[:, 1:]], 1)


@pytest.fixture
def fake():
    """The class, so that a test can choose its parameters or derive from it."""
    return FakeBackend


@pytest.fixture
def context():
    """`context(rows)`: patches that cover the whole of a random subject."""

    def make(rows):
        picture = torch.rand(rows, 4, CONTEXT_SIDE, CONTEXT_SIDE, generator=torch.Generator().manual_seed(1))
        return ContextBatch(picture, torch.tensor([[0.0, 0.0, 1.0]]).repeat(rows, 1))

    return make
