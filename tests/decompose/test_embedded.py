"""The embedded backend on random weights: sampling, shrinkage, determinism, files."""

import pytest
import torch

from yesnt.core.errors import CorruptError, JobError
from yesnt.decompose import embedded
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.global_context import CONTEXT_SIDE, ContextBatch
from yesnt.decompose.network import Network, NetworkShape, noised
from yesnt.decompose.weights import load_weights, save_weights
from yesnt.training.synthetic.materials import CLASSES, PRIOR

TINY = NetworkShape(widths=(8, 8, 16), depths=(1, 1, 1), condition=8, denoiser=(8, 8))


def context_of(rows, order=None):
    """Global context of `rows` patches."""
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(rows, 4, CONTEXT_SIDE, CONTEXT_SIDE, generator=generator)
    location = torch.rand(rows, 3, generator=generator)
    order = torch.arange(rows) if order is None else order
    return ContextBatch(image[order], location[order])


@pytest.fixture(scope="module")
def tiny_weights(tmp_path_factory):
    torch.manual_seed(0)
    network = Network(TINY)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(network, path, 32)
    return path


def test_noising_keeps_the_variance():
    clean, noise = torch.randn(8, 2, 64, 64), torch.randn(8, 2, 64, 64)
    for time in (0.1, 0.5, 1.0):
        assert float(noised(clean, noise, torch.full((8,), time)).var()) == pytest.approx(1, abs=0.05)
    torch.testing.assert_close(noised(clean, noise, torch.ones(8)), noise, atol=1e-6, rtol=0)


def test_draws_are_stochastic_bounded_and_keyed_by_noise(tiny_weights):
    backend = EmbeddedBackend(tiny_weights, steps=2)
    rgb, matte = torch.rand(8, 3, 32, 32), torch.ones(8, 1, 32, 32)
    condition = backend.encode(rgb, matte, context_of(8))
    noise = torch.randn(8, len(backend.noise_sigmas), 32, 32)
    first = backend.sample(condition, noise)
    assert first.shape == (8, 2, 32, 32)
    assert 0 <= float(first.min()) <= float(first.max()) <= 1
    assert torch.equal(first, backend.sample(condition, noise))
    assert not torch.equal(first, backend.sample(condition, torch.randn_like(noise)))


def test_a_row_does_not_depend_on_its_neighbours_or_on_threads(tiny_weights):
    backend = EmbeddedBackend(tiny_weights)
    rgb, matte = torch.rand(8, 3, 32, 32), torch.ones(8, 1, 32, 32)
    noise = torch.randn(8, len(backend.noise_sigmas), 32, 32)
    drawn = backend.sample(backend.encode(rgb, matte, context_of(8)), noise)
    order = torch.tensor([3, 1, 7, 0, 2, 6, 5, 4])
    torch.testing.assert_close(
        backend.sample(backend.encode(rgb[order], matte, context_of(8, order)), noise[order]),
        drawn[order],
        atol=0,
        rtol=0,
    )
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2 if threads == 1 else 1)
        torch.testing.assert_close(
            backend.sample(backend.encode(rgb, matte, context_of(8)), noise), drawn, atol=0, rtol=0
        )
    finally:
        torch.set_num_threads(threads)


def test_roughness_is_shrunk_to_the_prior_and_samples_keep_their_spread(tiny_weights, monkeypatch):
    backend = EmbeddedBackend(tiny_weights, steps=2)
    condition = backend.encode(torch.rand(8, 3, 32, 32), torch.ones(8, 1, 32, 32), context_of(8))
    noise = torch.randn(8, len(backend.noise_sigmas), 32, 32)
    drawn, expected = backend.sample(condition, noise), backend.predict_mean(condition)
    share = embedded.SHRINKAGE_FACTOR
    monkeypatch.setattr(embedded, "SHRINKAGE_FACTOR", 1.0)
    free, read = backend.sample(condition, noise), backend.predict_mean(condition)
    assert torch.equal(drawn[:, 1], free[:, 1])
    assert torch.equal(expected[:, 1], read[:, 1])
    assert float(read[:, 0].std()) > 0
    prior = embedded.PRIOR_ROUGHNESS
    torch.testing.assert_close(expected[:, 0] - prior, share * (read[:, 0] - prior))
    wanted = (free[:, 0] + expected[:, 0] - read[:, 0]).clamp(0, 1)
    torch.testing.assert_close(drawn[:, 0], wanted)


def test_the_prior_is_that_of_the_painted_classes():
    total = sum(PRIOR.values())
    mean = sum(weight * CLASSES[name].roughness[0] for name, weight in PRIOR.items()) / total
    assert mean == pytest.approx(embedded.PRIOR_ROUGHNESS, abs=1e-3)


def test_number_of_steps_is_part_of_the_version_and_of_the_noise(tiny_weights):
    one, three = EmbeddedBackend(tiny_weights, 1), EmbeddedBackend(tiny_weights, 3)
    assert one.nfe != three.nfe
    assert len(three.noise_sigmas) == 3 * len(one.noise_sigmas)
    with pytest.raises(ValueError, match="steps"):
        EmbeddedBackend(tiny_weights, 5)


def test_missing_and_broken_weights_have_different_errors(tmp_path):
    with pytest.raises(JobError, match=r"yesnt\.training"):
        load_weights(tmp_path / "absent.safetensors")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"no safetensors")
    with pytest.raises(CorruptError, match="restore the file"):
        load_weights(broken)


def test_everything_is_made_on_the_network_s_device(tiny_weights):
    """The meta device computes nothing but refuses tensors of other devices, as CUDA would."""
    backend = EmbeddedBackend(tiny_weights, steps=2, device="meta")
    condition = backend.encode(torch.rand(8, 3, 32, 32), torch.ones(8, 1, 32, 32), context_of(8))
    drawn = backend.sample(condition, torch.randn(8, len(backend.noise_sigmas), 32, 32))
    assert drawn.device.type == backend.predict_mean(condition).device.type == "meta"
    assert drawn.shape == backend.predict_mean(condition).shape == (8, 2, 32, 32)


def test_noising_goes_from_the_clean_values_to_pure_noise():
    clean, noise = torch.rand(3, 2, 4, 4), torch.randn(3, 2, 4, 4)
    mixed = noised(clean, noise, torch.tensor([0.0, 0.5, 1.0]))
    torch.testing.assert_close(mixed[0], clean[0], atol=1e-6, rtol=0)
    torch.testing.assert_close(mixed[1], (clean[1] + noise[1]) * 0.5**0.5, atol=1e-6, rtol=0)
    torch.testing.assert_close(mixed[2], noise[2], atol=1e-6, rtol=0)


def test_a_weights_file_is_readable_by_everyone(tiny_weights):
    """safetensors creates files for their owner only; workers of a farm run as others."""
    assert tiny_weights.stat().st_mode & 0o777 == 0o644
