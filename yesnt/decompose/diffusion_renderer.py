"""Backend for the inverse DiffusionRenderer (Liang et al. 2025, SVD release), a video diffusion model.

The weights allow non-commercial use only. The model takes display-referred colour over black and denoises one quantity
at a time. Its output has three channels, whose mean is the quantity. The UNet is that of Stable Video Diffusion with a
learned embedding per quantity in place of the image embedding; the latents of the input frames are concatenated to the
noisy latents.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.noise import noise_field
from yesnt.decompose.backend import Clip, Footprint
from yesnt.decompose.blend import Patch, PatchGrid, PatchSum
from yesnt.decompose.latents import default_device, diffusers_for, encode_srgb, local_only, precision_named
from yesnt.decompose.published import DIFFUSION_RENDERER
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.threads import one_thread

Float32 = NDArray[np.float32]

_PASSES = (2, 1)
"""Indices of roughness and metallic among the quantities of the model."""

_TIME_IDS = (6.0, 127.0, 0.0)
"""Frames per second less one, motion bucket, and noise augmentation, as the authors set them."""

_DECODED_TOGETHER = 8
"""Frames per call of the decoder, as the authors set it; another number changes the result slightly."""

_LARGEST_NORM = 10.0
"""Largest norm of a quantity's embedding; longer ones are scaled down on lookup (`max_norm` of torch's Embedding)."""


class DiffusionRendererBackend:
    """Video backend that draws clips of roughness and metallic.

    For one patch and member the result equals a call of `StableVideoDiffusionPipeline` of diffusers without guidance,
    with the quantity's embedding in place of the image embedding and each frame's own latents concatenated to the
    noise. Noise is a keyed field per frame, member and quantity at 1/8 of the resolution. Patches crop it; overlapping
    windows have the same noise in the frames that they share.

    Args:
        folder: local checkpoint; nothing is downloaded.
        steps: denoising steps per quantity.
        patch: side of a patch in pixels, a multiple of 64.
        window: frames of a clip.
        window_overlap: least number of frames that consecutive windows share.
        precision: auto, float32, float16 or bfloat16.

    Raises:
        MissingPartError: diffusers is not installed.
        JobError: a file is missing, or the checkpoint is not the inverse model.
    """

    def __init__(
        self,
        folder: Path,
        steps: int = 20,
        patch: int = 512,
        window: int = 24,
        window_overlap: int = 6,
        precision: str = "auto",
    ) -> None:
        DIFFUSION_RENDERER.check(folder)
        diffusers = diffusers_for("diffusion-renderer")
        self._device = default_device()
        self._dtype = precision_named(precision, self._device)
        self._unet, contexts = _load_unet(diffusers, folder)
        self._vae = diffusers.AutoencoderKLTemporalDecoder.from_pretrained(
            folder, subfolder="vae", **local_only(folder)
        )
        for model in (self._unet, self._vae):
            model.to(self._device, self._dtype).requires_grad_(False).eval()
        self._contexts = contexts.to(self._device, self._dtype)
        self._scheduler = diffusers.EulerDiscreteScheduler.from_pretrained(
            folder, subfolder="scheduler", local_files_only=True
        )
        self._factor = 2 ** (len(self._vae.config.block_out_channels) - 1)
        self._steps, self._patch = steps, patch
        self.footprint = Footprint(patch, 64, steps * len(_PASSES), window, window_overlap)

    def draw(self, clip: Clip, seed: int, members: Sequence[int], settings: EnsembleSettings) -> Iterator[Float32]:
        """Draws members of a clip, [F, 2, H, W] each; arguments as in `VideoBackend.draw`."""
        height, width = clip.matte.shape[1:]
        grid = PatchGrid.cover(height, width, self._patch, settings.overlap, self.footprint.align)
        pad = ((0, 0), (0, grid.height - height), (0, grid.width - width))
        matte = np.pad(clip.matte, pad)
        patches = grid.covering(matte.max(axis=0))
        rgb = np.pad(clip.rgb, (*pad, (0, 0))).transpose(0, 3, 1, 2)
        conditions = [self.encode(torch.from_numpy(np.ascontiguousarray(grid.crop(rgb, p)))) for p in patches]
        weight = PatchSum(grid, 1)
        for patch in patches:
            weight.add(patch, np.ones((1, grid.size, grid.size), np.float32))
        safe = np.maximum(weight.value(), 1e-6)
        for member in members:
            noise = self._noise(seed, clip.frames, member, grid, settings.antithetic)
            sums = [PatchSum(grid, 2) for _ in clip.frames]
            for patch, condition in zip(patches, conditions, strict=True):
                for values, one in zip(self.sample(condition, self._crop(noise, patch)), sums, strict=True):
                    one.add(patch, values)
            yield np.stack([one.value() / safe for one in sums])[..., :height, :width].astype(np.float32)

    @one_thread()
    @torch.no_grad()
    def encode(self, rgb: torch.Tensor) -> torch.Tensor:
        """Encodes linear colour [F, 3, P, P], black outside the matte, to unscaled latents [F, 4, P/8, P/8]."""
        coded = 2 * encode_srgb(rgb).to(self._device, self._dtype) - 1
        latents = [self._vae.encode(frame[None]).latent_dist.mode() for frame in coded]
        return torch.cat(latents)

    @one_thread()
    @torch.no_grad()
    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> Float32:
        """Draws both quantities of a clip for one patch.

        Args:
            condition: [F, 4, p, p] latents that `encode` returned.
            noise: [F, 8, p, p] standard normal; the first four channels are for roughness, the others for metallic.

        Returns:
            [F, 2, 8p, 8p] roughness and metallic in [0, 1].
        """
        latents = noise.to(condition).chunk(len(_PASSES), 1)
        planes = [self._run(condition, part, number) for part, number in zip(latents, _PASSES, strict=True)]
        return torch.stack(planes, 1).float().numpy(force=True)

    def _run(self, condition: torch.Tensor, latent: torch.Tensor, number: int) -> torch.Tensor:
        """Denoises and decodes one quantity, [F, 8p, 8p]."""
        scheduler, context = self._scheduler, self._contexts[number][None, None]
        scheduler.set_timesteps(self._steps, device=latent.device)
        latent, condition = latent[None] * scheduler.init_noise_sigma, condition[None]
        times = torch.tensor([_TIME_IDS], device=latent.device, dtype=latent.dtype)
        for time in scheduler.timesteps:
            both = torch.cat([scheduler.scale_model_input(latent, time), condition], 2)
            predicted = self._unet(both, time, context, added_time_ids=times, return_dict=False)[0]
            latent = scheduler.step(predicted, time, latent, return_dict=False)[0]
        parts = (latent[0] / self._vae.config.scaling_factor).split(_DECODED_TOGETHER)
        decoded = torch.cat([self._vae.decode(part, num_frames=len(part), return_dict=False)[0] for part in parts])
        return (0.5 + 0.5 * decoded.float()).clamp(0, 1).mean(1)

    def _noise(self, seed: int, frames: Sequence[int], member: int, grid: PatchGrid, paired: bool) -> Float32:
        """Returns noise [F, 8, H/8, W/8]; an odd member of an antithetic pair has the negated field of the even one."""
        size = (grid.height // self._factor, grid.width // self._factor)
        twin = member - member % 2 if paired else member
        planes = 4 * len(_PASSES)
        noise = np.stack([noise_field(seed, frame, twin, *size, planes) for frame in frames])
        return -noise if paired and member % 2 else noise

    def _crop(self, noise: Float32, patch: Patch) -> torch.Tensor:
        top, left, side = (value // self._factor for value in (patch.top, patch.left, self._patch))
        return torch.from_numpy(np.ascontiguousarray(noise[..., top : top + side, left : left + side]))


def _load_unet(diffusers: Any, folder: Path) -> tuple[Any, torch.Tensor]:
    """Loads the UNet into the class of diffusers, and the embeddings of the quantities [n, c] that the release adds."""
    from safetensors.torch import load_file

    config = json.loads((folder / "unet" / "config.json").read_text())
    _refuse_other_models(config, folder)
    known = inspect.signature(diffusers.UNetSpatioTemporalConditionModel.__init__).parameters
    model = diffusers.UNetSpatioTemporalConditionModel(**{k: v for k, v in config.items() if k in known})
    if config.get("temporal_cross_attention_dim", 0) is None:
        _without_temporal_context(model)
    name = local_only(folder)["variant"]
    stem = "diffusion_pytorch_model" + ("" if name is None else f".{name}")
    weights = load_file(folder / "unet" / f"{stem}.safetensors")
    contexts = weights.pop("context_embedding.weight").float()
    model.load_state_dict(weights)
    norms = contexts.norm(dim=1, keepdim=True)
    return model, contexts * (_LARGEST_NORM / norms.clamp_min(_LARGEST_NORM))


def _refuse_other_models(config: dict[str, Any], folder: Path) -> None:
    if config.get("context_embedding_type") != "clip" or config.get("in_channels") != 8:
        raise JobError(
            "the UNet is not the inverse DiffusionRenderer's",
            str(folder / "unet" / "config.json"),
            'context_embedding_type "clip" and 8 input channels (the forward model has 24)',
            f"download {DIFFUSION_RENDERER.source}",
        )


def _without_temporal_context(model: Any) -> None:
    """Removes the cross-attention of the temporal blocks, which the class of diffusers always builds."""
    for block in model.modules():
        if type(block).__name__ == "TemporalBasicTransformerBlock":
            block.attn2 = block.norm2 = None
