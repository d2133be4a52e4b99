"""Published checkpoints of the backends: required files and where they are published. No torch."""

from __future__ import annotations

from yesnt.decompose.checkpoint import Published

_MODEL = "diffusion_pytorch_model"
_TEXT = "model"


def _either_precision(folder: str, stem: str) -> tuple[str, str]:
    return (f"{folder}/{stem}.safetensors", f"{folder}/{stem}.fp16.safetensors")


_STABLE_DIFFUSION = (
    "model_index.json",
    "scheduler/scheduler_config.json",
    "unet/config.json",
    _either_precision("unet", _MODEL),
    "vae/config.json",
    _either_precision("vae", _MODEL),
    "text_encoder/config.json",
    _either_precision("text_encoder", _TEXT),
    "tokenizer/tokenizer_config.json",
)
"""Layout of a Stable Diffusion checkpoint as diffusers saves it."""

MARIGOLD = Published(
    "Marigold-IID appearance", "prs-eth/marigold-iid-appearance-v1-1 (Hugging Face)", _STABLE_DIFFUSION
)

RGBX = Published("RGB to X", "zheng95z/rgb-to-x (Hugging Face)", _STABLE_DIFFUSION)

DIFFUSION_RENDERER = Published(
    "the inverse DiffusionRenderer (SVD)",
    "nexuslrf/diffusion_renderer-inverse-svd (Hugging Face)",
    (
        "scheduler/scheduler_config.json",
        "unet/config.json",
        _either_precision("unet", _MODEL),
        "vae/config.json",
        _either_precision("vae", _MODEL),
    ),
)
"""Parts of Stable Video Diffusion without the image encoder, which the model does not use."""

COSMOS = Published(
    "DiffusionRenderer-Cosmos",
    "nv-tlabs/cosmos-transfer1-diffusion-renderer (GitHub) and its weights by "
    "scripts/download_diffusion_renderer_checkpoints.py --checkpoint_dir checkpoints (56 GB)",
    (
        "cosmos_predict1/diffusion/inference/diffusion_renderer_pipeline.py",
        "cosmos_predict1/diffusion/inference/diffusion_renderer_utils/dataset_inference.py",
        "checkpoints/Diffusion_Renderer_Inverse_Cosmos_7B/model.pt",
        "checkpoints/Cosmos-Tokenize1-CV8x8x8-720p/encoder.jit",
        "checkpoints/Cosmos-Tokenize1-CV8x8x8-720p/decoder.jit",
        "checkpoints/Cosmos-Tokenize1-CV8x8x8-720p/mean_std.pt",
        "checkpoints/Cosmos-Tokenize1-CV8x8x8-720p/image_mean_std.pt",
    ),
)
"""A checkout with its own Python environment; it runs as a process of its own."""
