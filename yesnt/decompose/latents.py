"""Shared parts of the latent-diffusion backends: published layout, latent noise, precision, optional package."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import torch
from torch.nn import functional as F

from yesnt.core.errors import JobError, MissingPartError

_MODEL = "diffusion_pytorch_model"

PRECISIONS = {"float32": torch.float32, "float16": torch.float16, "bfloat16": torch.bfloat16}
"""Names of precisions in the job file."""


def diffusers_for(backend: str) -> Any:
    """Imports diffusers for the named backend and returns the module.

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
    """Returns the `variant` of the checkpoint's files for diffusers: None for full precision, or "fp16"."""
    return None if (folder / "unet" / f"{_MODEL}.safetensors").is_file() else "fp16"


def local_only(folder: Path) -> dict[str, Any]:
    """Returns arguments of `from_pretrained` that forbid downloads and pickles."""
    return {"local_files_only": True, "use_safetensors": True, "variant": precision_of(folder)}


def latent_noise(noise: torch.Tensor, factor: int) -> torch.Tensor:
    """Reduces white noise [B, C, P, P] to [B, C, P/factor, P/factor], N(0, 1): block means times the factor.

    Patch origins are multiples of the factor, so neighbouring patches have the same values where they overlap.
    """
    return F.avg_pool2d(noise, factor) * factor


def default_device() -> str:
    """Returns "cuda" if there is a CUDA device, else "cpu"."""
    return "cuda" if torch.cuda.is_available() else "cpu"


def precision_named(name: str, device: str) -> torch.dtype:
    """Returns the torch type of a precision name; `auto` is half precision on CUDA and single elsewhere.

    Raises:
        JobError: the name is unknown.
    """
    if name == "auto":
        return torch.float16 if device == "cuda" else torch.float32
    if name not in PRECISIONS:
        raise JobError(
            f"There is no precision {name!r}", "key decompose.knobs", f"auto, {', '.join(PRECISIONS)}", "correct it"
        )
    return PRECISIONS[name]


def prepare_model(model: Any, device: str, precision: torch.dtype) -> Any:
    """Moves a network to a device, freezes it and stores its convolutions channels last."""
    model = model.to(device, precision).requires_grad_(False).eval()
    return model.to(memory_format=torch.channels_last)


def encode_srgb(linear: torch.Tensor) -> torch.Tensor:
    """Encodes linear Rec.709 [..., 3, H, W] as sRGB code values (IEC 61966-2-1), clipped to [0, 1]."""
    from kornia.color import linear_rgb_to_rgb  # imported here: the embedded model does without kornia

    coded: torch.Tensor = linear_rgb_to_rgb(linear.clamp(0, 1))
    return coded
