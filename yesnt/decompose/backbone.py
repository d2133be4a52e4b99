"""EfficientNet-Lite0 without its classifier: features learnt from a million photographs, which we leave as they are.

The layers are those of the network's publishers (Tan & Le 2019; the lite variant has no squeeze-and-excitation and
clips at 6): convolutions with their norms folded in, padded as TensorFlow pads, so that the published weights fit.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F


class Stage(NamedTuple):
    """Blocks of one width; the first of them shrinks."""

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
"""Of EfficientNet-Lite0, after a stem of 32 channels at half the resolution."""

_STEM = 32

FEATURE_STAGES = (1, 2, 4, 6)
"""Stages whose features are handed on: the last of each resolution from a quarter to a thirty-second."""

FEATURE_CHANNELS = tuple(STAGES[number].channels for number in FEATURE_STAGES)
"""Channels of each."""


class Conv(nn.Module):
    """Convolution with TensorFlow's "same" padding: what cannot be shared out evenly goes last."""

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
    """Widens, filters each channel, narrows; added to its input where the shapes agree (MobileNetV2's block)."""

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
    """All blocks up to the last, and what they say at four resolutions."""

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
        """All in order."""
        return [module for module in self.modules() if isinstance(module, Bottleneck)]

    def forward(self, picture: torch.Tensor) -> list[torch.Tensor]:
        """Features of a picture.

        Args:
            picture: [B, 3, S, S] display code values, -1 .. 1; S a multiple of 32.

        Returns:
            `FEATURE_CHANNELS` channels at S/4, S/8, S/16 and S/32.
        """
        x, told = F.relu6(self.stem(picture)), []
        for number, stage in enumerate(self.stages):
            x = stage(x)
            if number in FEATURE_STAGES:
                told.append(x)
        return told
