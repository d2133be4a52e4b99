"""Auxiliary predictor: roughness and metallic of the whole subject from ImageNet features.

The estimator (`yesnt.decompose.network.Estimator`) is trained on synthetic images and relies on colour. The auxiliary
predictor is a per-location perceptron on features of a frozen backbone that was trained on photographs
(`yesnt.decompose.backbone`), which respond to shape and object. The two predictions are averaged; their difference
conditions the denoiser.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional as F

from yesnt.decompose.backbone import FEATURE_CHANNELS, Backbone

AUXILIARY_INPUT_SIDE = 288
"""Side in pixels of the image of the whole subject that the predictor takes."""

AUXILIARY_OUTPUT_SIDE = AUXILIARY_INPUT_SIDE // 4
"""Side in locations of the prediction."""

AUXILIARY_WEIGHT = 0.5
"""Weight of the auxiliary prediction in the mean of both; the estimator has the rest."""

_WHITE = 4.0
"""Linear radiance that maps to display white. Highlights exceed 1 at a normal exposure."""


class AuxiliaryPredictor(nn.Module):
    """Frozen backbone and a perceptron of three layers per location.

    Args:
        first: channels of the first hidden layer.
        second: channels of the second hidden layer.
    """

    def __init__(self, first: int, second: int) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.projections = nn.ModuleList(nn.Conv2d(channels, first, 1, bias=False) for channels in FEATURE_CHANNELS)
        self.bias = nn.Parameter(torch.zeros(first))
        self.hidden = nn.Conv2d(first, second, 1)
        self.output = nn.Conv2d(second, 2, 1)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Predicts materials at every location.

        Args:
            image: [B, 4, S, S] straight linear rgb and matte of the whole subject; S a multiple of 32.

        Returns:
            [B, 2, S/4, S/4] roughness and metallic, scaled from [0, 1] to [-1, 1].
        """
        side = image.shape[-1] // 4
        # A linear layer commutes with bilinear upsampling; projecting the small feature maps first costs less.
        features = zip(self.projections, self.backbone(display_encode(image)), strict=True)
        first = sum(upsample(project(x), side) for project, x in features) + self.bias[:, None, None]
        return self.output(F.relu(self.hidden(F.relu(first)))).clamp(-1, 1)


def display_encode(image: torch.Tensor) -> torch.Tensor:
    """Encodes linear radiance the way photographs are encoded, over grey.

    Reinhard's extended curve (2002, eq. 4) with white point `_WHITE` keeps highlights distinguishable; the sRGB
    transfer function (IEC 61966-2-1) follows.

    Args:
        image: [B, 4, S, S] straight linear rgb and matte.

    Returns:
        [B, 3, S, S] code values in [-1, 1]; 0 (mid grey) outside the matte.
    """
    rgb, matte = image[:, :3].clamp(0, _WHITE), image[:, 3:]
    tone_mapped = rgb * (1 + rgb / _WHITE**2) / (1 + rgb)
    coded = torch.where(
        tone_mapped <= 0.0031308, 12.92 * tone_mapped, 1.055 * tone_mapped.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    )
    return (2 * coded - 1) * matte


def upsample(x: torch.Tensor, side: int) -> torch.Tensor:
    """Resizes [B, C, h, h] bilinearly to [B, C, side, side]; returns the input if it has that size."""
    return x if x.shape[-1] == side else F.interpolate(x, (side, side), mode="bilinear", align_corners=False)


def fuse_predictions(condition: torch.Tensor, auxiliary: torch.Tensor) -> torch.Tensor:
    """Averages the predictions of the estimator and the auxiliary predictor.

    Args:
        condition: [B, C, h, w]; channels 0 and 1 are roughness and metallic as the estimator predicts them, in [-1, 1].
        auxiliary: [B, 2, h, w] auxiliary prediction at the same locations.

    Returns:
        [B, C + 2, h, w]: channels 0 and 1 hold the mean of both, the last two the difference auxiliary - estimator,
        from which the denoiser learns how far samples have to spread.
    """
    difference = auxiliary - condition[:, :2]
    return torch.cat([condition[:, :2] + AUXILIARY_WEIGHT * difference, condition[:, 2:], difference], 1)
