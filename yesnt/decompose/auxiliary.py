"""The second opinion: what a network that knows photographs says of the whole subject, place by place.

The estimator has only seen painted pictures, and tells a material by its colour first. A backbone trained on photographs
(`backbone.py`) knows shapes and things; a small perceptron on its features says which roughness and metallic they go with.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional as F

from yesnt.decompose.backbone import FEATURE_CHANNELS, Backbone

AUXILIARY_INPUT_SIDE = 288
"""Side in pixels of the picture of the whole subject that is surveyed."""

AUXILIARY_OUTPUT_SIDE = AUXILIARY_INPUT_SIDE // 4
"""FeatureSamples per side of an auxiliary."""

_WEIGHT = 0.5
"""Of the auxiliary in what is expected, the estimator's being the rest."""

_WHITE = 4.0
"""Radiance that is shown as white; a picture of exposure near 1 has its highlights above 1."""


class AuxiliaryPredictor(nn.Module):
    """Backbone and perceptron.

    Args:
        first: channels of the perceptron's first layer.
        second: of its second.
    """

    def __init__(self, first: int, second: int) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.projections = nn.ModuleList(nn.Conv2d(channels, first, 1, bias=False) for channels in FEATURE_CHANNELS)
        self.bias = nn.Parameter(torch.zeros(first))
        self.hidden = nn.Conv2d(first, second, 1)
        self.output = nn.Conv2d(second, 2, 1)

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        """What is thought of every place.

        Args:
            picture: [B, 4, S, S] straight linear rgb and matte of the whole subject; S a multiple of 32.

        Returns:
            [B, 2, S/4, S/4] roughness and metallic, -1 .. 1 for 0 .. 1.
        """
        side = picture.shape[-1] // 4
        # A layer without its bend may come before the enlargement: the sum is the perceptron's on upsample features.
        told = (level(x) for level, x in zip(self.projections, self.backbone(display_encode(picture)), strict=True))
        first = sum(upsample(x, side) for x in told) + self.bias[:, None, None]
        return self.output(F.relu(self.hidden(F.relu(first)))).clamp(-1, 1)


def display_encode(picture: torch.Tensor) -> torch.Tensor:
    """Linear [B, 4, S, S] as photographs are coded, on grey: [B, 3, S, S] in -1 .. 1.

    Highlights are compressed by Reinhard's curve (2002, eq. 4), which keeps those up to `_WHITE` apart, then sRGB.
    """
    rgb, matte = picture[:, :3].clamp(0, _WHITE), picture[:, 3:]
    shown = rgb * (1 + rgb / _WHITE**2) / (1 + rgb)
    coded = torch.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)
    return (2 * coded - 1) * matte


def upsample(x: torch.Tensor, side: int) -> torch.Tensor:
    """[B, C, h, h] to [B, C, side, side]."""
    return x if x.shape[-1] == side else F.interpolate(x, (side, side), mode="bilinear", align_corners=False)


def fuse_predictions(condition: torch.Tensor, auxiliary: torch.Tensor) -> torch.Tensor:
    """What sampling needs to know, once the auxiliary is fuse_predictions.

    Args:
        condition: [B, C, h, w]; channels 0 and 1 are what the estimator predicts_mean.
        auxiliary: [B, 2, h, w] at the same places.

    Returns:
        [B, C + 2, h, w]: channels 0 and 1 the mean of both, the last two how far the auxiliary is from the estimator, which
        tells the denoiser how far to spread.
    """
    apart = auxiliary - condition[:, :2]
    return torch.cat([condition[:, :2] + _WEIGHT * apart, condition[:, 2:], apart], 1)
