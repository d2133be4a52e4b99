"""What latent-diffusion backends share: published layout, noise at latent resolution, the optional package."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import torch
from torch.nn import functional as F

from yesnt.core.errors import JobError, MissingPartError

_MODEL = "diffusion_pytorch_model"

PRECISIONS = {"float32": torch.float32, "float16": torch.float16, "bfloat16": torch.bfloat16}


def diffusers_for(backend: str) -> Any:
    """The diffusers package.

    Raises:
        MissingPartError: it is not installed; names the backend and the extra.
    """
    try:
        return importlib.import_module("diffusers")
    except ImportError as error:
        raise MissingPartError(
            f"the {backend} backend needs diffusers",
            "decompose.backend",
            "diffusers and transformers installed",
            "pip install 'yesnt[diffusers]'",
        ) from error


def precision_of(folder: Path) -> str | None:
    """The `variant` that a checkpoint is stored in: None (full) or "fp16"."""
    return None if (folder / "unet" / f"{_MODEL}.safetensors").is_file() else "fp16"


def local_only(folder: Path) -> dict[str, Any]:
    """Arguments of `from_pretrained` that keep it off the network and off pickles."""
    return {"local_files_only": True, "use_safetensors": True, "variant": precision_of(folder)}


def latent_noise(noise: torch.Tensor, factor: int) -> torch.Tensor:
    """White noise at 1/factor of the resolution, N(0, 1): block means times the factor.

    Patch origins are multiples of the factor, so neighbouring patches see the same values where they overlap.
    """
    return F.avg_pool2d(noise, factor) * factor


def default_device() -> str:
    """CUDA where there is one."""
    return "cuda" if torch.cuda.is_available() else "cpu"


def precision_named(name: str, device: str) -> torch.dtype:
    """The precision that a job asks for; `auto`: half on CUDA, single elsewhere.

    Raises:
        JobError: there is no such precision.
    """
    if name == "auto":
        return torch.float16 if device == "cuda" else torch.float32
    if name not in PRECISIONS:
        raise JobError(
            f"There is no precision {name!r}", "key decompose.knobs", f"auto, {', '.join(PRECISIONS)}", "correct it"
        )
    return PRECISIONS[name]


def placed(model: Any, device: str, precision: torch.dtype) -> Any:
    """A network on its device, frozen, its convolutions laid out channels last."""
    model = model.to(device, precision).requires_grad_(False).eval()
    return model.to(memory_format=torch.channels_last)


def srgb(linear: torch.Tensor) -> torch.Tensor:
    """Linear to sRGB code values (IEC 61966-2-1), clipped to [0, 1]."""
    x = linear.clamp(0, 1)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)
