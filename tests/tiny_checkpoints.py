"""Random checkpoints of the published layouts, small enough to run in a test."""

import json

import torch


def tiny_stable_diffusion(folder, targets):
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


def tiny_diffusion_renderer(folder, temporal_context=True):
    """A random checkpoint in the layout of the release: SVD's parts, a vector a quantity beside the UNet's weights."""
    import diffusers
    from safetensors.torch import save_file

    torch.manual_seed(0)
    shape = {
        "in_channels": 8, "out_channels": 4, "block_out_channels": [32, 32], "layers_per_block": 1,
        "down_block_types": ["CrossAttnDownBlockSpatioTemporal", "DownBlockSpatioTemporal"],
        "up_block_types": ["UpBlockSpatioTemporal", "CrossAttnUpBlockSpatioTemporal"], "cross_attention_dim": 8,
        "addition_time_embed_dim": 8, "projection_class_embeddings_input_dim": 24, "num_attention_heads": [2, 2],
        "num_frames": 4, "transformer_layers_per_block": 1, "sample_size": 8,
    }  # fmt: skip
    unet = diffusers.UNetSpatioTemporalConditionModel(**shape)
    weights = dict(unet.state_dict())
    if not temporal_context:
        weights = {
            k: v for k, v in weights.items() if not ("temporal_transformer" in k and (".attn2." in k or ".norm2." in k))
        }
    weights["context_embedding.weight"] = 20 * torch.randn(16, 8)
    extra = {
        "_class_name": "UNetCustomSpatioTemporalConditionModel", "context_embedding_type": "clip",
        "context_vocab_size": 16, "multi_res_encoder_hidden_states": False,
        "temporal_cross_attention_dim": 8 if temporal_context else None,
    }  # fmt: skip
    (folder / "unet").mkdir(parents=True)
    (folder / "unet" / "config.json").write_text(json.dumps({**shape, **extra}))
    save_file({k: v.contiguous() for k, v in weights.items()}, folder / "unet" / "diffusion_pytorch_model.safetensors")
    diffusers.AutoencoderKLTemporalDecoder(
        block_out_channels=(32, 32, 32, 32), latent_channels=4, layers_per_block=1,
        down_block_types=("DownEncoderBlock2D",) * 4,
    ).save_pretrained(folder / "vae")  # fmt: skip
    diffusers.EulerDiscreteScheduler(
        beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", prediction_type="v_prediction",
        timestep_spacing="leading", timestep_type="continuous", use_karras_sigmas=True, sigma_min=0.002,
        sigma_max=700.0, interpolation_type="linear", steps_offset=1,
    ).save_pretrained(folder / "scheduler")  # fmt: skip
    return folder
