"""Backend for Marigold-IID "appearance" (Ke et al. 2025) through diffusers: the recommended large backend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from yesnt.core.errors import JobError
from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.latents import (
    default_device,
    diffusers_for,
    encode_srgb,
    latent_noise,
    local_only,
    precision_named,
    prepare_model,
)
from yesnt.decompose.published import MARIGOLD
from yesnt.decompose.threads import one_thread


class MarigoldBackend:
    """Samples the material target of Marigold-IID.

    The model takes sRGB-encoded colour and returns linear roughness (red) and metallic (green). A member equals a
    direct call of `MarigoldIntrinsicsPipeline` with `latents` at native resolution. The image is encoded once for all
    members, and only the material target is decoded.

    Args:
        folder: local checkpoint; nothing is downloaded.
        steps: denoising steps; 0: the number that the checkpoint states.
        patch: side of a patch in pixels; 0: the processing resolution that the checkpoint states.
        batch: rows of every call; another number changes the last bits.
        precision: auto, float32, float16 or bfloat16.

    Raises:
        MissingPartError: diffusers is not installed.
        JobError: a file is missing, or the checkpoint has no material target or a scheduler that draws its own noise.
    """

    def __init__(self, folder: Path, steps: int = 0, patch: int = 0, batch: int = 1, precision: str = "auto") -> None:
        MARIGOLD.check(folder)
        self._pipeline, self._device, self.batch = _load(folder), default_device(), batch
        dtype = precision_named(precision, self._device)
        self._pipeline.to(self._device, dtype)
        for model in (self._pipeline.unet, self._pipeline.vae):
            prepare_model(model, self._device, dtype)
        self._target = _material_target(self._pipeline, folder)
        self.align = int(self._pipeline.vae_scale_factor)
        self.patch = patch or int(self._pipeline.default_processing_resolution)
        self.nfe = steps or int(self._pipeline.default_denoising_steps)
        self.noise_sigmas = (0.0,) * int(self._pipeline.unet.config.out_channels)
        self._text = _empty_prompt(self._pipeline)

    @one_thread()
    @torch.no_grad()
    def encode(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """Encodes linear colour [B, 3, P, P] to latents [B, 4, P/8, P/8]. Outside the matte colour is black already."""
        vae = self._pipeline.vae
        coded = 2 * encode_srgb(rgb.to(self._device, vae.dtype)) - 1
        return vae.encode(coded).latent_dist.mode() * vae.config.scaling_factor

    @one_thread()
    @torch.no_grad()
    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Denoises the latents of all targets and decodes the material, [B, 2, P, P] in [0, 1]."""
        pipeline = self._pipeline
        latent = latent_noise(noise.to(condition), self.align)
        pipeline.scheduler.set_timesteps(self.nfe, device=latent.device)
        text = self._text.expand(len(latent), -1, -1)
        for time in pipeline.scheduler.timesteps:
            predicted = pipeline.unet(
                torch.cat([condition, latent], 1), time, encoder_hidden_states=text, return_dict=False
            )[0]
            latent = pipeline.scheduler.step(predicted, time, latent).prev_sample
        channels = pipeline.vae.config.latent_channels
        target = latent[:, self._target * channels : (self._target + 1) * channels]
        decoded: torch.Tensor = pipeline.decode_prediction(target)
        return decoded[:, :2].float()


def _load(folder: Path) -> Any:
    pipeline = diffusers_for("marigold").MarigoldIntrinsicsPipeline.from_pretrained(folder, **local_only(folder))
    pipeline.set_progress_bar_config(disable=True)
    return pipeline


def _material_target(pipeline: Any, folder: Path) -> int:
    """Returns the index of the material target.

    Raises:
        JobError: there is no material target, or the scheduler draws noise of its own, which would break determinism.
    """
    names = list((pipeline.target_properties or {}).get("target_names", ()))
    if "material" not in names:
        raise JobError(
            f"the checkpoint predicts {', '.join(names) or 'nothing named'}",
            str(folder / "model_index.json"),
            "a target named material",
            "use the appearance checkpoint, not the lighting one",
        )
    if type(pipeline.scheduler).__name__ != "DDIMScheduler":
        raise JobError(
            f"the scheduler {type(pipeline.scheduler).__name__} draws noise of its own",
            str(folder / "scheduler"),
            "DDIMScheduler, so that a member depends on its key alone",
            "restore the published scheduler",
        )
    return names.index("material")


@torch.no_grad()
def _empty_prompt(pipeline: Any) -> torch.Tensor:
    """Embedding of the empty prompt [1, n, c] without padding, as in the training of the model."""
    tokens = pipeline.tokenizer("", padding="do_not_pad", truncation=True, return_tensors="pt").input_ids
    embedding: torch.Tensor = pipeline.text_encoder(tokens.to(pipeline.device))[0]
    return embedding.to(pipeline.dtype)
