"""Perceptual distance in the features of AlexNet: LPIPS (Zhang et al. 2018) and ST-LPIPS (Ghildyal and Liu 2022).

The network is defined here and loads published weights. Their names tell which of the two it is. ST-LPIPS has
stride 1 in its first convolution and low-passes before every decimation, so that a shift of a pixel costs little.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import CorruptError

if TYPE_CHECKING:
    import torch

Picture = NDArray[np.floating]
State = Mapping[str, "torch.Tensor"]
Features = tuple["torch.Tensor", ...]

LEAST_SIDE = 32
"""Pictures are padded with black to at least this side: the network halves four times."""

_CONVOLUTIONS = {  # published names of the five convolutions, by variant
    "stlpips": ("net.slice1.0", "net.slice2.5", "net.slice3.9", "net.slice4.11", "net.slice5.13"),
    "lpips": ("net.slice1.0", "net.slice2.3", "net.slice3.6", "net.slice4.8", "net.slice5.10"),
}
_PADDING = (2, 2, 1, 1, 1)
_LOW_PASS = (1.0, 2.0, 1.0)
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # colour statistics of ImageNet in [-1, 1]


class PerceptualNet:
    """Distance of two pictures: squared difference of unit features, weighted, averaged over the picture, summed.

    Args:
        state: published weights of LPIPS or ST-LPIPS with AlexNet, backbone included.

    Attributes:
        name: "stlpips" or "lpips", as the weights are.

    Raises:
        CorruptError: the weights are neither.
    """

    def __init__(self, state: State) -> None:
        self.name = next((n for n, names in _CONVOLUTIONS.items() if f"{names[4]}.weight" in state), "")
        heads = [f"lin{i}.model.1.weight" for i in range(5)]
        if not self.name or any(head not in state for head in heads):
            raise CorruptError(
                "The perceptual weights are not LPIPS or ST-LPIPS with AlexNet", f"{sorted(state)[:4]} ...",
                "net.slice1.0.weight .. net.slice5.*, lin0 .. lin4", "save the state_dict of the whole model",
            )  # fmt: skip
        self._layers = [(state[f"{n}.weight"].float(), state[f"{n}.bias"].float()) for n in _CONVOLUTIONS[self.name]]
        self._heads = [state[head].float() for head in heads]

    def features(self, picture: Picture) -> Features:
        """Unit features of five layers of a display picture [H, W, 3] in [0, 1]."""
        import torch

        with torch.no_grad():
            x = self._prepared(picture)
            layers = self._shift_tolerant(x) if self.name == "stlpips" else self._plain(x)
            return tuple(layer / (layer.square().sum(1, keepdim=True).sqrt() + 1e-10) for layer in layers)

    def between(self, a: Features, b: Features) -> float:
        """Distance of two pictures of one size by their features; 0 for equal ones."""
        import torch
        from torch.nn import functional as F

        with torch.no_grad():
            layers = zip(a, b, self._heads, strict=True)
            return float(sum(F.conv2d((x - y).square(), head).mean() for x, y, head in layers))

    def distance(self, a: Picture, b: Picture) -> float:
        """Distance of two display pictures [H, W, 3] in [0, 1]."""
        return self.between(self.features(a), self.features(b))

    def _prepared(self, picture: Picture) -> torch.Tensor:
        import torch

        height, width = picture.shape[:2]
        pad = ((0, max(0, LEAST_SIDE - height)), (0, max(0, LEAST_SIDE - width)), (0, 0))
        padded = np.pad(np.asarray(picture, np.float64), pad)
        values = (padded * 2 - 1 - np.array(_SHIFT)) / np.array(_SCALE)
        return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)[None], dtype=np.float32))

    def _convolve(self, i: int, x: torch.Tensor, stride: int = 1) -> torch.Tensor:
        from torch.nn import functional as F

        weight, bias = self._layers[i]
        return F.conv2d(x, weight, bias, stride=stride, padding=_PADDING[i])

    def _plain(self, x: torch.Tensor) -> list[torch.Tensor]:
        """Krizhevsky's network as torchvision has it: outputs after each rectification."""
        from torch.nn import functional as F

        layers = [self._convolve(0, x, stride=4).relu()]
        for i in range(1, 5):
            pooled = F.max_pool2d(layers[-1], 3, 2) if i < 3 else layers[-1]
            layers.append(self._convolve(i, pooled).relu())
        return layers

    def _shift_tolerant(self, x: torch.Tensor) -> list[torch.Tensor]:
        """The anti-aliased network: every decimation is a low-pass with stride 2, padding 2, after a dense step."""
        from torch.nn import functional as F

        layers = [_decimate(self._convolve(0, x)).relu()]
        for i in range(1, 5):
            pooled = _decimate(F.max_pool2d(layers[-1], 3, 1)) if i < 3 else layers[-1]
            layers.append(self._convolve(i, pooled).relu())
        return layers


def _decimate(x: torch.Tensor) -> torch.Tensor:
    """Binomial low-pass [1 2 1] in both directions, every second pixel, two mirrored pixels around."""
    import torch
    from torch.nn import functional as F

    window = torch.tensor(_LOW_PASS) / 4
    kernel = (window[:, None] * window)[None, None].expand(x.shape[1], 1, 3, 3)
    return F.conv2d(F.pad(x, (2, 2, 2, 2), mode="reflect"), kernel, stride=2, groups=x.shape[1])
