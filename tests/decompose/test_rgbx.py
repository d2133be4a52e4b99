import json
import warnings

import pytest
import torch

from yesnt.decompose.registry import open_backend

PATCH = 32


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, tiny_stable_diffusion):
    pytest.importorskip("diffusers")
    folder = tmp_path_factory.mktemp("rgbx")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, part in tiny_stable_diffusion(folder / "parts", targets=1).items():
            part.save_pretrained(folder / "checkpoint" / name)
    (folder / "checkpoint" / "model_index.json").write_text(
        json.dumps({"_class_name": "StableDiffusionAOVMatEstPipeline"})
    )
    return folder / "checkpoint"


@pytest.fixture
def backend(checkpoint):
    from yesnt.decompose.rgbx import RgbxBackend

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return RgbxBackend(checkpoint, steps=3, patch=PATCH)


@pytest.mark.filterwarnings("ignore")
def test_each_quantity_follows_its_prompt_and_its_noise(backend, context):
    generator = torch.Generator().manual_seed(0)
    condition = backend.encode(
        torch.rand(1, 3, PATCH, PATCH, generator=generator), torch.ones(1, 1, PATCH, PATCH), context(1)
    )
    assert condition.shape == (1, 4, PATCH // 8, PATCH // 8)
    noise = torch.randn(1, len(backend.noise_sigmas), PATCH, PATCH, generator=generator)
    first = backend.sample(condition, noise)
    assert first.shape == (1, 2, PATCH, PATCH)
    assert torch.equal(first, backend.sample(condition, noise))
    same_noise = backend.sample(condition, torch.cat([noise[:, :4], noise[:, :4]], 1))
    assert (same_noise[:, 0] - same_noise[:, 1]).abs().max() > 1e-6, "prompts must matter"
    other = backend.sample(condition, torch.cat([noise[:, :4], torch.randn_like(noise[:, 4:])], 1))
    assert torch.equal(other[:, 0], first[:, 0])
    assert not torch.equal(other[:, 1], first[:, 1])


@pytest.mark.filterwarnings("ignore")
def test_schedule_is_the_authors(backend):
    backend._scheduler.set_timesteps(4)
    assert backend._scheduler.timesteps[0] == 999
    assert float(backend._scheduler.alphas_cumprod[-1]) == pytest.approx(0, abs=1e-6)
    assert backend.nfe == 6


@pytest.mark.filterwarnings("ignore")
def test_registry_opens_it_once_the_licence_is_accepted(checkpoint):
    assert open_backend("rgbx", checkpoint, ["Adobe-Research"]).patch == 768
