"""Backend for RGB-X (Zeng et al. 2024), the RGB to X model, through parts of diffusers; non-commercial weights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.latents import (
    default_device,
    diffusers_for,
    latent_noise,
    local_only,
    precision_named,
    prepare_model,
)
from yesnt.decompose.published import RGBX
from yesnt.decompose.threads import one_thread

_PROMPTS = ("Roughness", "Metallicness")


class RgbxBackend:
    """Denoises one quantity per prompt; takes linear colour and uses the first output channel.

    Args:
        folder: local checkpoint; nothing is downloaded.
        steps: denoising steps per quantity.
        patch: side of a patch in pixels; the authors use images of about 1000 pixels.
        batch: rows of every call; another number changes the last bits.
        precision: auto, float32, float16 or bfloat16.

    Raises:
        MissingPartError: diffusers or transformers is not installed.
        JobError: a file is missing.
    """

    def __init__(
        self, folder: Path, steps: int = 50, patch: int = 768, batch: int = 1, precision: str = "auto"
    ) -> None:
        RGBX.check(folder)
        self._device, self.batch = default_device(), batch
        dtype = precision_named(precision, self._device)
        diffusers, options = diffusers_for("rgbx"), local_only(folder)
        self._unet = diffusers.UNet2DConditionModel.from_pretrained(folder, subfolder="unet", **options)
        self._vae = diffusers.AutoencoderKL.from_pretrained(folder, subfolder="vae", **options)
        for model in (self._unet, self._vae):
            prepare_model(model, self._device, dtype)
        # The authors override the stored schedule: zero terminal SNR, trailing steps.
        stored = diffusers.DDIMScheduler.load_config(folder, subfolder="scheduler", local_files_only=True)
        self._scheduler = diffusers.DDIMScheduler.from_config(
            stored, rescale_betas_zero_snr=True, timestep_spacing="trailing"
        )
        self._texts = [_embedding(folder, prompt, options).to(self._device, dtype) for prompt in _PROMPTS]
        self._steps = steps
        self.align = 2 ** (len(self._vae.config.block_out_channels) - 1)
        self.patch = patch
        self.nfe = steps * len(_PROMPTS)
        self.noise_sigmas = (0.0,) * (int(self._unet.config.out_channels) * len(_PROMPTS))

    @one_thread()
    @torch.no_grad()
    def encode(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """Encodes linear colour [B, 3, P, P] to latents [B, 4, P/8, P/8]. Outside the matte colour is black already."""
        linear = 2 * rgb.to(self._device, self._vae.dtype).clamp(0, 1) - 1
        latent: torch.Tensor = self._vae.encode(linear).latent_dist.mode() * self._vae.config.scaling_factor
        return latent

    @one_thread()
    @torch.no_grad()
    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Draws both quantities, each from its own half of the noise channels, [B, 2, P, P] in [0, 1]."""
        latents = latent_noise(noise.to(condition), self.align).chunk(len(_PROMPTS), 1)
        planes = [self._run(condition, latent, text) for latent, text in zip(latents, self._texts, strict=True)]
        return torch.cat(planes, 1).float()

    def _run(self, condition: torch.Tensor, latent: torch.Tensor, text: torch.Tensor) -> torch.Tensor:
        self._scheduler.set_timesteps(self._steps, device=latent.device)
        text = text.expand(len(latent), -1, -1)
        for time in self._scheduler.timesteps:
            both = torch.cat([self._scheduler.scale_model_input(latent, time), condition], 1)
            predicted = self._unet(both, time, encoder_hidden_states=text, return_dict=False)[0]
            latent = self._scheduler.step(predicted, time, latent, return_dict=False)[0]
        decoded: torch.Tensor = self._vae.decode(latent / self._vae.config.scaling_factor, return_dict=False)[0]
        return (0.5 + 0.5 * decoded[:, :1]).clamp(0, 1)


@torch.no_grad()
def _embedding(folder: Path, prompt: str, options: dict[str, Any]) -> torch.Tensor:
    """Text embedding of a prompt padded to the length of the encoder."""
    from transformers import CLIPTextModel, CLIPTokenizer

    tokenizer = CLIPTokenizer.from_pretrained(folder, subfolder="tokenizer", local_files_only=True)
    encoder = CLIPTextModel.from_pretrained(folder, subfolder="text_encoder", **options)
    tokens = tokenizer(prompt, padding="max_length", truncation=True, return_tensors="pt").input_ids
    embedding: torch.Tensor = encoder(tokens)[0]
    return embedding
