"""Backbone of the auxiliary predictor: EfficientNet-Lite0 without its classifier, pretrained on ImageNet, frozen.

The layers are those of the publishers (Tan & Le 2019; the lite variant has no squeeze-and-excitation and uses ReLU6).
Batch norms are folded into the convolutions, and padding follows TensorFlow, so that the published weights fit.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F


class Stage(NamedTuple):
    """Blocks of one width; the first of them has the stride.

    Attributes:
        repeats: number of blocks.
        kernel: side of the depthwise filter.
        stride: of the first block.
        expansion: hidden channels over input channels.
        channels: output channels.
    """

    repeats: int
    kernel: int
    stride: int
    expansion: int
    channels: int


STAGES = (
    Stage(1, 3, 1, 1, 16),
    Stage(2, 3, 2, 6, 24),
    Stage(2, 5, 2, 6, 40),
    Stage(3, 3, 2, 6, 80),
    Stage(3, 5, 1, 6, 112),
    Stage(4, 5, 2, 6, 192),
    Stage(1, 3, 1, 6, 320),
)
"""Stages of EfficientNet-Lite0, after a stem of 32 channels at half the resolution."""

_STEM = 32

FEATURE_STAGES = (1, 2, 4, 6)
"""Indices of the stages whose features are returned: the last of each resolution from 1/4 to 1/32."""

FEATURE_CHANNELS = tuple(STAGES[number].channels for number in FEATURE_STAGES)
"""Channels of each returned feature map."""


class Conv(nn.Module):
    """Convolution with TensorFlow's "same" padding: an odd remainder is padded at the end."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, groups=groups)
        self.kernel, self.stride = kernel, stride

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, C, h, w] to [B, outputs, ceil(h / stride), ceil(w / stride)]."""
        rows, columns = (self._pad(length) for length in x.shape[2:])
        if rows + columns:
            x = F.pad(x, (columns // 2, columns - columns // 2, rows // 2, rows - rows // 2))
        return self.conv(x)

    def _pad(self, length: int) -> int:
        return max((-(-length // self.stride) - 1) * self.stride + self.kernel - length, 0)


class Bottleneck(nn.Module):
    """Inverted residual block of MobileNetV2 (Sandler et al. 2018): expand, depthwise filter, project.

    Input and output are added if their shapes agree.
    """

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        self.expand = Conv(inputs, wide, 1) if expansion > 1 else None
        self.filter = Conv(wide, wide, kernel, stride, groups=wide)
        self.project = Conv(wide, outputs, 1)
        self.added = stride == 1 and inputs == outputs

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, inputs, h, w] to [B, outputs, h / stride, w / stride]."""
        wide = x if self.expand is None else F.relu6(self.expand(x))
        narrow = self.project(F.relu6(self.filter(wide)))
        return x + narrow if self.added else narrow


class Backbone(nn.Module):
    """All stages up to the last; returns features at four resolutions."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = Conv(3, _STEM, 3, 2)
        stages, inputs = [], _STEM
        for stage in STAGES:
            blocks = []
            for number in range(stage.repeats):
                stride = stage.stride if number == 0 else 1
                blocks.append(Bottleneck(inputs, stage.channels, stage.kernel, stride, stage.expansion))
                inputs = stage.channels
            stages.append(nn.Sequential(*blocks))
        self.stages = nn.ModuleList(stages)

    def blocks(self) -> list[Bottleneck]:
        """Returns all blocks in order."""
        return [module for module in self.modules() if isinstance(module, Bottleneck)]

    def forward(self, image: torch.Tensor) -> list[torch.Tensor]:
        """Computes features of an image.

        Args:
            image: [B, 3, S, S] display code values in [-1, 1]; S a multiple of 32.

        Returns:
            Four maps with `FEATURE_CHANNELS` channels at S/4, S/8, S/16 and S/32.
        """
        x, features = F.relu6(self.stem(image)), []
        for number, stage in enumerate(self.stages):
            x = stage(x)
            if number in FEATURE_STAGES:
                features.append(x)
        return features
