import json
import warnings

import numpy as np
import pytest
import torch

from yesnt.core.color import srgb_encode
from yesnt.core.errors import JobError
from yesnt.decompose.checkpoint import Published
from yesnt.decompose.ensemble import decompose_frame
from yesnt.decompose.latents import encode_srgb, latent_noise, precision_named
from yesnt.decompose.published import MARIGOLD
from yesnt.decompose.registry import open_backend
from yesnt.decompose.settings import EnsembleSettings

PATCH = 32


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, tiny_stable_diffusion):
    pytest.importorskip("diffusers")
    folder = tmp_path_factory.mktemp("marigold")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import diffusers

        parts = tiny_stable_diffusion(folder, targets=2)
        diffusers.MarigoldIntrinsicsPipeline(
            **parts,
            prediction_type="intrinsics",
            target_properties={"target_names": ["albedo", "material"]},
            default_denoising_steps=2,
            default_processing_resolution=PATCH,
        ).save_pretrained(folder / "checkpoint", safe_serialization=True)
    return folder / "checkpoint"


@pytest.mark.filterwarnings("ignore")
def test_a_member_equals_a_direct_call_of_the_pipeline(checkpoint, context):
    from diffusers import MarigoldIntrinsicsPipeline

    backend = open_backend("marigold", checkpoint)
    generator = torch.Generator().manual_seed(1)
    rgb = torch.rand(1, 3, PATCH, PATCH, generator=generator)
    noise = torch.randn(1, len(backend.noise_sigmas), PATCH, PATCH, generator=generator)
    ours = backend.sample(backend.encode(rgb, torch.ones(1, 1, PATCH, PATCH), context(1)), noise)

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


def test_srgb_is_the_project_s_curve_and_clips():
    linear = torch.linspace(-0.2, 1.2, 3 * 40).reshape(1, 3, 5, 8)
    expected = srgb_encode(linear.clamp(0, 1).numpy())
    np.testing.assert_allclose(encode_srgb(linear).numpy(), expected, atol=1e-6)


def test_precision_is_half_on_cuda_single_elsewhere_or_as_named():
    assert precision_named("auto", "cuda") is torch.float16
    assert precision_named("auto", "cpu") is torch.float32
    assert precision_named("bfloat16", "cpu") is torch.bfloat16
    with pytest.raises(JobError, match=r"no precision 'half'.*auto, float32, float16, bfloat16"):
        precision_named("half", "cpu")


def test_latent_noise_keeps_unit_variance_and_is_the_same_in_every_crop():
    noise = torch.randn(1, 2, 128, 128, generator=torch.Generator().manual_seed(0))
    latent = latent_noise(noise, 8)
    assert float(latent.var()) == pytest.approx(1, abs=0.15)
    torch.testing.assert_close(latent_noise(noise[..., 32:96, 16:80], 8), latent[..., 4:12, 2:10], atol=0, rtol=0)


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
