import json
import warnings

import numpy as np
import pytest
import torch

from yesnt.decompose.checkpoint import Published
from yesnt.decompose.ensemble import decompose_frame
from yesnt.decompose.marigold import MARIGOLD
from yesnt.decompose.registry import open_backend
from yesnt.decompose.settings import EnsembleSettings
from yesnt.errors import JobError

PATCH = 32


def tiny_checkpoint(folder):
    """A random checkpoint of Marigold-IID's true layout: two targets of four latent channels, factor 8."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        diffusers = pytest.importorskip("diffusers")
        transformers = pytest.importorskip("transformers")
        vocabulary = folder / "vocabulary"
        vocabulary.mkdir(parents=True)
        words = {"<|startoftext|>": 0, "<|endoftext|>": 1, "a</w>": 2, "a": 3}
        (vocabulary / "vocab.json").write_text(json.dumps(words))
        (vocabulary / "merges.txt").write_text("#version: 0.2\n")
        files = (str(vocabulary / "vocab.json"), str(vocabulary / "merges.txt"))
        tokenizer = transformers.CLIPTokenizer(*files, model_max_length=8)
        torch.manual_seed(0)
        text = transformers.CLIPTextModel(
            transformers.CLIPTextConfig(
                vocab_size=4, hidden_size=8, intermediate_size=8, num_hidden_layers=1, num_attention_heads=2,
                max_position_embeddings=8, bos_token_id=0, eos_token_id=1, pad_token_id=1,
            )
        )  # fmt: skip
        unet = diffusers.UNet2DConditionModel(
            sample_size=4, in_channels=12, out_channels=8, block_out_channels=(8, 8), layers_per_block=1,
            down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"), norm_num_groups=4,
            up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
            cross_attention_dim=8, attention_head_dim=4,
        )  # fmt: skip
        vae = diffusers.AutoencoderKL(
            block_out_channels=(4, 4, 4, 4), norm_num_groups=2, latent_channels=4, layers_per_block=1,
            down_block_types=("DownEncoderBlock2D",) * 4, up_block_types=("UpDecoderBlock2D",) * 4,
        )  # fmt: skip
        pipeline = diffusers.MarigoldIntrinsicsPipeline(
            unet=unet, vae=vae, scheduler=diffusers.DDIMScheduler(), text_encoder=text, tokenizer=tokenizer,
            prediction_type="intrinsics", target_properties={"target_names": ["albedo", "material"]},
            default_denoising_steps=2, default_processing_resolution=PATCH,
        )  # fmt: skip
        pipeline.save_pretrained(folder / "checkpoint", safe_serialization=True)
    return folder / "checkpoint"


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    pytest.importorskip("diffusers")
    return tiny_checkpoint(tmp_path_factory.mktemp("marigold"))


@pytest.mark.filterwarnings("ignore")
def test_a_member_equals_a_direct_call_of_the_pipeline(checkpoint):
    from diffusers import MarigoldIntrinsicsPipeline

    backend = open_backend("marigold", checkpoint)
    generator = torch.Generator().manual_seed(1)
    rgb = torch.rand(1, 3, PATCH, PATCH, generator=generator)
    noise = torch.randn(1, len(backend.noise_sigmas), PATCH, PATCH, generator=generator)
    ours = backend.sample(backend.encode(rgb, torch.ones(1, 1, PATCH, PATCH)), noise)

    pipeline = MarigoldIntrinsicsPipeline.from_pretrained(checkpoint, local_files_only=True)
    pipeline.set_progress_bar_config(disable=True)
    srgb = torch.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    latents = torch.nn.functional.avg_pool2d(noise, 8) * 8
    theirs = pipeline(srgb, latents=latents, processing_resolution=0, output_type="pt").prediction
    torch.testing.assert_close(ours, theirs[1:2, :2], atol=1e-5, rtol=0)
    assert (theirs[0, :2] - theirs[1, :2]).abs().max() > 1e-3, "the target must matter for the test to mean anything"


@pytest.mark.filterwarnings("ignore")
def test_a_frame_of_several_patches_is_keyed_and_repeatable(checkpoint):
    backend = open_backend("marigold", checkpoint)
    rgb = np.random.default_rng(0).random((50, 40, 3), dtype=np.float32)
    matte = np.ones((50, 40), np.float32)
    runs = [decompose_frame(rgb, matte, backend, EnsembleSettings(3), 0, frame) for frame in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    assert (runs[0][0] != runs[2][0]).any()
    assert runs[0][1].mean() > 1e-4
    assert backend.align == 8
    assert len(backend.weights_digest) == 64


@pytest.mark.filterwarnings("ignore")
def test_other_checkpoints_of_the_family_are_refused(checkpoint, tmp_path):
    import shutil

    lighting = tmp_path / "lighting"
    shutil.copytree(checkpoint, lighting)
    index = json.loads((lighting / "model_index.json").read_text())
    index["target_properties"] = {"target_names": ["albedo", "shading", "residual"]}
    (lighting / "model_index.json").write_text(json.dumps(index))
    with pytest.raises(JobError, match="appearance checkpoint"):
        open_backend("marigold", lighting)


def test_absent_files_are_named_with_their_source(tmp_path):
    (tmp_path / "model_index.json").write_text("{}")
    with pytest.raises(JobError, match=r"unet/config\.json.*prs-eth/marigold"):
        MARIGOLD.check(tmp_path)


def test_either_precision_satisfies_a_file_with_variants(tmp_path):
    published = Published("x", "y", (("a.safetensors", "a.fp16.safetensors"),))
    (tmp_path / "a.fp16.safetensors").write_bytes(b"1")
    published.check(tmp_path)
    before = published.digest(tmp_path)
    (tmp_path / "a.fp16.safetensors").write_bytes(b"2")
    assert published.digest(tmp_path) != before
