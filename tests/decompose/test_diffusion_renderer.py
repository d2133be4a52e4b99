import json
import shutil
import warnings

import numpy as np
import pytest
import torch

from yesnt.core.errors import JobError
from yesnt.core.noise import noise_field
from yesnt.decompose.diffusion_renderer import DiffusionRendererBackend
from yesnt.decompose.registry import footprint, open_backend
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.window import make_clip

FRAMES, PATCH, STEPS = 4, 64, 2
LICENCE = ["NVIDIA-NonCommercial"]

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, tiny_diffusion_renderer):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return tiny_diffusion_renderer(tmp_path_factory.mktemp("diffusion_renderer") / "checkpoint")


@pytest.fixture(scope="module")
def backend(checkpoint):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return DiffusionRendererBackend(checkpoint, STEPS, PATCH, FRAMES, 1)


def srgb(x):
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def pipeline(checkpoint, quantity):
    """diffusers' own video pipeline with the quantity's vector for the picture's embedding."""
    import diffusers
    from safetensors.torch import load_file
    from transformers import CLIPImageProcessor, CLIPVisionConfig, CLIPVisionModelWithProjection

    stored = load_file(checkpoint / "unet" / "diffusion_pytorch_model.safetensors")
    vector = torch.nn.Embedding.from_pretrained(stored.pop("context_embedding.weight"), max_norm=10.0)(
        torch.tensor([quantity])
    )
    config = json.loads((checkpoint / "unet" / "config.json").read_text())
    names = "context_embedding_type context_vocab_size multi_res_encoder_hidden_states temporal_cross_attention_dim"
    config = {k: v for k, v in config.items() if k not in names.split() and not k.startswith("_")}
    unet = diffusers.UNetSpatioTemporalConditionModel(**config)
    unet.load_state_dict(stored)
    clip = CLIPVisionModelWithProjection(
        CLIPVisionConfig(
            hidden_size=8, intermediate_size=8, num_hidden_layers=1, num_attention_heads=2, image_size=224,
            patch_size=112, projection_dim=8,
        )
    )  # fmt: skip
    made = diffusers.StableVideoDiffusionPipeline(
        vae=diffusers.AutoencoderKLTemporalDecoder.from_pretrained(checkpoint, subfolder="vae"),
        image_encoder=clip, unet=unet,
        scheduler=diffusers.EulerDiscreteScheduler.from_pretrained(checkpoint, subfolder="scheduler"),
        feature_extractor=CLIPImageProcessor(),
    )  # fmt: skip
    made._encode_image = lambda *arguments, **named: vector.detach()[None]
    made.set_progress_bar_config(disable=True)
    return made


def test_a_still_clip_equals_a_direct_call_of_the_pipeline(checkpoint, backend):
    generator = torch.Generator().manual_seed(1)
    picture = torch.rand(1, 3, PATCH, PATCH, generator=generator)
    noise = torch.randn(FRAMES, 8, PATCH // 8, PATCH // 8, generator=generator)
    ours = backend.sample(backend.encode(picture.expand(FRAMES, -1, -1, -1)), noise)
    assert ours.shape == (FRAMES, 2, PATCH, PATCH)
    for plane, (quantity, part) in enumerate(((2, noise[:, :4]), (1, noise[:, 4:]))):
        theirs = pipeline(checkpoint, quantity)(
            srgb(picture), height=PATCH, width=PATCH, num_frames=FRAMES, num_inference_steps=STEPS, fps=7,
            motion_bucket_id=127, noise_aug_strength=0.0, min_guidance_scale=1.0, max_guidance_scale=1.0,
            decode_chunk_size=8, latents=part[None], output_type="pt",
        ).frames  # fmt: skip
        np.testing.assert_allclose(ours[:, plane], theirs[0].mean(1).numpy(), atol=2e-5)
    assert np.abs(ours[:, 0] - ours[:, 1]).max() > 1e-3, "the quantity must matter for the test to mean anything"


def test_every_frame_has_its_own_picture_beside_the_noise(backend):
    generator = torch.Generator().manual_seed(2)
    pictures = torch.rand(FRAMES, 3, PATCH, PATCH, generator=generator)
    noise = torch.randn(FRAMES, 8, PATCH // 8, PATCH // 8, generator=generator)
    latents = backend.encode(pictures)
    torch.testing.assert_close(latents[2:3], backend.encode(pictures[2:3]), atol=1e-6, rtol=0)
    vae = backend._vae
    direct = vae.encode(2 * srgb(pictures[1:2]) - 1).latent_dist.mode()
    torch.testing.assert_close(latents[1:2], direct, atol=1e-5, rtol=0)
    changed = latents.clone()
    changed[3] = 0
    assert np.abs(backend.sample(latents, noise) - backend.sample(changed, noise)).max() > 1e-4


def test_members_are_keyed_by_seed_frame_and_number(backend):
    rng = np.random.default_rng(0)
    rgb = [rng.random((PATCH, 80, 3), dtype=np.float32) for _ in range(FRAMES)]
    clip = make_clip(rgb, [np.ones((PATCH, 80), np.float32)] * FRAMES, range(1001, 1005), FRAMES)
    settings = EnsembleSettings(2, antithetic=False)
    one, two = backend.draw(clip, 0, (0, 1), settings)
    assert one.shape == (FRAMES, 2, PATCH, 80)
    np.testing.assert_array_equal(next(backend.draw(clip, 0, (1,), settings)), two)
    assert (one != two).any()
    assert (next(backend.draw(clip, 1, (0,), settings)) != one).any()


def test_noise_of_a_frame_is_the_same_in_every_window_and_pairs_are_opposite(backend):
    from yesnt.decompose.blend import PatchGrid

    grid = PatchGrid.cover(PATCH, 128, PATCH, 0.25, 64)
    first = backend._noise(5, (1001, 1002, 1003), 0, grid, True)
    later = backend._noise(5, (1003, 1004), 0, grid, True)
    np.testing.assert_array_equal(first[2], later[0])
    np.testing.assert_array_equal(first[2], noise_field(5, 1003, 0, 8, 16, 8))
    np.testing.assert_array_equal(backend._noise(5, (1001,), 1, grid, True)[0], -first[0])


def test_a_checkpoint_without_temporal_cross_attention_is_read_too(tmp_path, tiny_diffusion_renderer):
    folder = tiny_diffusion_renderer(tmp_path / "bare", temporal_context=False)
    backend = DiffusionRendererBackend(folder, 1, PATCH, FRAMES, 1)
    condition = backend.encode(torch.rand(FRAMES, 3, PATCH, PATCH))
    assert np.isfinite(backend.sample(condition, torch.randn(FRAMES, 8, 8, 8))).all()


def test_the_forward_model_is_refused(checkpoint, tmp_path):
    shutil.copytree(checkpoint, tmp_path / "forward")
    path = tmp_path / "forward" / "unet" / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"in_channels": 24}))
    with pytest.raises(JobError, match="inverse"):
        DiffusionRendererBackend(tmp_path / "forward")


def test_licence_and_files_are_asked_for_by_name(checkpoint, tmp_path):
    with pytest.raises(JobError, match="--accept-license 'NVIDIA-NonCommercial'"):
        open_backend("diffusion-renderer", checkpoint)
    with pytest.raises(JobError, match=r"vae/config\.json.*nexuslrf/diffusion_renderer-inverse-svd"):
        open_backend("diffusion-renderer", tmp_path, LICENCE)
    assert footprint("diffusion-renderer", checkpoint, {"steps": 3, "window": 8}).nfe == 6
