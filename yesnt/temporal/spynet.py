"""A learned flow: SPyNet (Ranjan and Black 2017), six levels of a small network that corrects the upsampled flow.

Weights are given by the caller; checkpoints name them `basic_module.LEVEL.basic_module.LAYER.weight` and `.bias`, often
with a prefix. Any other network serves as well: `flow_and_validity` takes every function of two pictures.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError, MissingPartError

if TYPE_CHECKING:
    from torch import Tensor

LEVELS = 6
LAYERS = (0, 2, 4, 6, 8)
"""Positions of the convolutions in a level; a ReLU follows each but the last."""

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Normalisation of sRGB in [0, 1] that the network was trained with (ImageNet's)."""


def open_spynet(path: Path) -> SpyNet:
    """SPyNet with the weights of a file: .safetensors, or a PyTorch checkpoint, of which tensors only are read.

    Raises:
        JobError: the file is not readable as tensors (a pickle that holds anything else is never run).
        MissingPartError: the weights of a layer are absent.
    """
    import torch

    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            return SpyNet(load_file(path))
        found = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, pickle.UnpicklingError, RuntimeError, ValueError) as error:
        raise JobError(
            f"The flow's weights cannot be read ({type(error).__name__})", str(path),
            "a .safetensors file, or a PyTorch checkpoint that holds tensors only", "convert it, or choose another",
        ) from error  # fmt: skip
    return SpyNet(found.get("state_dict", found))


class SpyNet:
    """SPyNet as a matcher for `flow_and_validity`: call it with two `[H, W, 3]` 8-bit sRGB pictures.

    Args:
        state: name to tensor, as `torch.load(path, weights_only=True)` gives it.

    Raises:
        MissingPartError: the weights of a layer are absent.
    """

    def __init__(self, state: Mapping[str, Tensor]) -> None:
        suffix = "basic_module.0.basic_module.0.weight"
        prefix = next((name.removesuffix(suffix) for name in state if name.endswith(suffix)), "")
        self.layers: list[list[tuple[Tensor, Tensor]]] = []
        for level in range(LEVELS):
            names = [f"{prefix}basic_module.{level}.basic_module.{layer}" for layer in LAYERS]
            absent = [name for name in names if f"{name}.weight" not in state or f"{name}.bias" not in state]
            if absent:
                raise MissingPartError(
                    "SPyNet's weights are incomplete", absent[0], "six levels of five convolutions", "load another file"
                )
            self.layers.append([(state[f"{n}.weight"].float(), state[f"{n}.bias"].float()) for n in names])

    def __call__(self, picture: NDArray[np.uint8], following: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Flow [H, W, 2] in pixels from `picture` to `following`."""
        import torch
        from torch.nn import functional

        height, width = picture.shape[:2]
        size = (-(-height // 32) * 32, -(-width // 32) * 32)
        with torch.inference_mode():
            pyramids = [self._pyramid(p, size) for p in (picture, following)]
            flow = torch.zeros(1, 2, max(1, size[0] // 64), max(1, size[1] // 64))
            for level, (here, there) in enumerate(zip(*pyramids, strict=True)):
                flow = 2.0 * functional.interpolate(flow, size=here.shape[2:], mode="bilinear", align_corners=True)
                stack = torch.cat([here, _warp(there, flow), flow], 1)
                for weight, bias in self.layers[level][:-1]:
                    stack = functional.relu(functional.conv2d(stack, weight, bias, padding=3))
                flow = flow + functional.conv2d(stack, *self.layers[level][-1], padding=3)
            flow = functional.interpolate(flow, size=(height, width), mode="bilinear", align_corners=False)
        scale = np.array([width / size[1], height / size[0]], np.float32)
        return (flow[0].permute(1, 2, 0).numpy() * scale).astype(np.float32)

    def _pyramid(self, picture: NDArray[np.uint8], size: tuple[int, int]) -> list[Tensor]:
        """Normalised picture [1, 3, h, w] at six sizes, smallest first; each is half the next."""
        import torch
        from torch.nn import functional

        image = torch.from_numpy(picture.astype(np.float32) / 255).permute(2, 0, 1)[None]
        mean, std = (torch.tensor(values).view(1, 3, 1, 1) for values in (MEAN, STD))
        image = functional.interpolate((image - mean) / std, size=size, mode="bilinear", align_corners=False)
        levels = [image]
        for _ in range(LEVELS - 1):
            levels.append(functional.avg_pool2d(levels[-1], 2, count_include_pad=False))
        return levels[::-1]


def _warp(image: Tensor, flow: Tensor) -> Tensor:
    """`image` [1, 3, H, W] sampled at p + flow(p); the border is repeated."""
    import torch
    from torch.nn import functional

    height, width = image.shape[2:]
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x = 2 * (column + flow[:, 0]) / max(width - 1, 1) - 1
    y = 2 * (row + flow[:, 1]) / max(height - 1, 1) - 1
    options: dict[str, Any] = {"padding_mode": "border", "align_corners": True}
    return functional.grid_sample(image, torch.stack([x, y], -1), **options)
