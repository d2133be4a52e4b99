"""Backends without a network, for the laws of blending and sampling."""

import json

import pytest
import torch

from yesnt.decompose.backend import Licence


class FakeBackend:
    """roughness = mix of the picture and the noise, metallic = the matte."""

    name = "fake"
    version = "1"
    licence = Licence("Apache-2.0", commercial=True)
    patch = 32
    align = 1
    batch = 4
    noise_sigmas = (0.0, 6.0)
    evaluations = 1
    weights_digest = "0"

    def __init__(self, noise_gain=0.1, batch=4, patch=32):
        self.noise_gain, self.batch, self.patch = noise_gain, batch, patch
        self.sampled = 0

    def encode(self, rgb, matte):
        assert rgb.shape == (self.batch, 3, self.patch, self.patch)
        assert matte.shape == (self.batch, 1, self.patch, self.patch)
        return torch.cat([rgb[:, :1], matte], 1)

    def sample(self, condition, noise):
        self.sampled += 1
        assert noise.shape == (self.batch, len(self.noise_sigmas), self.patch, self.patch)
        return torch.cat([condition[:, :1] + self.noise_gain * noise[:, 1:2], condition[:, 1:]], 1)


@pytest.fixture
def fake():
    """The class, so that a test can choose its parameters or refine it."""
    return FakeBackend


def _tiny_stable_diffusion(folder, targets):
    """Random parts of a Stable Diffusion checkpoint: a picture's latent and `targets` noisy ones go in, factor 8."""
    import diffusers
    import transformers

    words = {"<|startoftext|>": 0, "<|endoftext|>": 1}
    words |= {
        letter + end: i for i, (letter, end) in enumerate([(c, e) for c in "roughnesmtalic" for e in ("", "</w>")], 2)
    }
    words = {word: i for i, word in enumerate(words)}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "vocab.json").write_text(json.dumps(words))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=16)
    torch.manual_seed(0)
    text = transformers.CLIPTextModel(
        transformers.CLIPTextConfig(
            vocab_size=len(words), hidden_size=8, intermediate_size=8, num_hidden_layers=1, num_attention_heads=2,
            max_position_embeddings=16, bos_token_id=0, eos_token_id=1, pad_token_id=1,
        )
    )  # fmt: skip
    unet = diffusers.UNet2DConditionModel(
        sample_size=4, in_channels=4 + 4 * targets, out_channels=4 * targets, block_out_channels=(8, 8),
        layers_per_block=1, norm_num_groups=4, cross_attention_dim=8, attention_head_dim=4,
        down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"),
        up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
    )  # fmt: skip
    vae = diffusers.AutoencoderKL(
        block_out_channels=(4, 4, 4, 4), norm_num_groups=2, latent_channels=4, layers_per_block=1,
        down_block_types=("DownEncoderBlock2D",) * 4, up_block_types=("UpDecoderBlock2D",) * 4,
    )  # fmt: skip
    return {
        "unet": unet, "vae": vae, "scheduler": diffusers.DDIMScheduler(), "text_encoder": text, "tokenizer": tokenizer,
    }  # fmt: skip


@pytest.fixture(scope="session")
def tiny_stable_diffusion():
    """Builds random parts; a test saves them in the layout of its checkpoint."""
    return _tiny_stable_diffusion
