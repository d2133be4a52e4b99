"""Network of the embedded model: a U-Net that estimates the mean materials, and a small denoiser that draws samples."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import nn
from torch.nn import functional as F

from yesnt.decompose.auxiliary import AuxiliaryPredictor
from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.statistics import STATISTICS, colour_code, local_statistics


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of the network.

    Attributes:
        widths: channels of the estimator at 1/2, 1/4, 1/8, ... of the resolution.
        depths: residual blocks per level of its encoder.
        condition: channels that the estimator returns at 1/2 resolution; the first two are the expected material.
        denoiser: channels of the denoiser at 1/2 and 1/4 resolution.
        smooth_planes: blurred noise planes that the denoiser takes besides the two of the state.
        context: channels of the context encoder at 1/2, 1/4, ... of the context image.
        auxiliary: channels of the two hidden layers of the auxiliary predictor; empty: there is none.
    """

    widths: tuple[int, ...] = (32, 64, 128, 208)
    depths: tuple[int, ...] = (1, 1, 2, 3)
    condition: int = 34
    denoiser: tuple[int, int] = (32, 64)
    smooth_planes: int = 3
    context: tuple[int, ...] = (24, 48, 72, 80)
    auxiliary: tuple[int, ...] = ()

    @property
    def denoiser_condition(self) -> int:
        """Channels of the denoiser's condition: two more for the difference of an auxiliary predictor."""
        return self.condition + (2 if self.auxiliary else 0)

    def header(self) -> str:
        """Returns the sizes as JSON for the header of a weights file."""
        return json.dumps(asdict(self))

    @classmethod
    def from_header(cls, text: str) -> NetworkShape:
        """Parses what `header` returned."""
        values: dict[str, Any] = json.loads(text)
        return cls(**{name: _frozen(value) for name, value in values.items()})


def _frozen(value: Any) -> Any:
    """JSON's lists as tuples."""
    return tuple(value) if isinstance(value, list) else value


class PixelNorm(nn.LayerNorm):
    """Layer norm over the channels of each pixel.

    Unlike group norm it does not mix in the empty surroundings of a subject. It has no affine parameters: the next
    convolution provides them, and their gradients, which are sums over all pixels, are off by half in bfloat16.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, elementwise_affine=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, C, h, w] to the same shape."""
        return super().forward(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class ChannelNorm(nn.BatchNorm2d):
    """Batch norm of the estimator: running statistics per channel, a fixed scale and shift at inference.

    With norms over the channels of a pixel, one common vector grew in the coarse levels until it hid all other features
    (`tests/benchmarks/decompose_estimator.py` zeroes each level), and the network used colour only. Batch norm forces
    every channel to vary. Inference uses running statistics, so the result of a row depends on that row only.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, momentum=0.05)


class ResidualBlock(nn.Module):
    """Residual block of two 3x3 convolutions with optional feature-wise linear modulation (FiLM, Perez et al. 2018).

    Args:
        channels: input and output channels.
        time_channels: channels of the time embedding that scales and shifts the hidden features; 0: no modulation.
    """

    def __init__(self, channels: int, time_channels: int = 0) -> None:
        super().__init__()
        self.norm = PixelNorm(channels) if time_channels else ChannelNorm(channels)
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.modulation = nn.Linear(time_channels, 2 * channels) if time_channels else None
        nn.init.zeros_(self.second.weight)

    def forward(self, x: torch.Tensor, time: torch.Tensor | None = None) -> torch.Tensor:
        """[B, C, h, w] and, if modulated, the time embedding [B, time_channels] to [B, C, h, w]."""
        middle = self.first(self.norm(x))
        if self.modulation is not None and time is not None:
            scale, shift = self.modulation(time)[:, :, None, None].chunk(2, 1)
            middle = middle * (1 + scale) + shift
        return x + self.second(F.silu(middle))


class SkipMerge(nn.Module):
    """Upsamples coarse features and adds the features of the encoder at the finer level (skip connection)."""

    def __init__(self, fine: int, coarse: int, norm: type[nn.Module] = ChannelNorm) -> None:
        super().__init__()
        self.norm_fine, self.norm_coarse = norm(fine), norm(coarse)
        self.fine = nn.Conv2d(fine, fine, 3, padding=1)
        self.coarse = nn.Conv2d(coarse, fine, 1)

    def forward(self, fine: torch.Tensor, coarse: torch.Tensor) -> torch.Tensor:
        """[B, F, 2h, 2w] and [B, C, h, w] to [B, F, 2h, 2w].

        Both are normalised first, because coarse features have larger magnitudes and would dominate the sum.
        """
        raised = F.interpolate(self.coarse(self.norm_coarse(coarse)), scale_factor=2, mode="nearest")
        return F.silu(self.fine(self.norm_fine(fine)) + raised)


class GlobalPooling(nn.Module):
    """Adds a projection of the mean features over the matte to every location of the coarsest level."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = ChannelNorm(channels)
        last = nn.Linear(channels, channels)
        nn.init.zeros_(last.weight)
        self.mix = nn.Sequential(nn.Linear(channels, channels), nn.SiLU(), last)

    def forward(self, x: torch.Tensor, cover: torch.Tensor) -> torch.Tensor:
        """Features [B, C, h, w] and coverage [B, 1, h, w] to [B, C, h, w]."""
        mean = (self.norm(x) * cover).sum((2, 3)) / cover.sum((2, 3)).clamp_min(1e-3)
        return x + self.mix(mean)[:, :, None, None]


class ContextEncoder(nn.Module):
    """U-Net over the image of the whole subject. Its features tell where on the subject a patch lies.

    Args:
        widths: channels at 1/2, 1/4, ... of the image.
    """

    def __init__(self, widths: tuple[int, ...]) -> None:
        super().__init__()
        pairs = list(pairwise(widths))
        self.stem = nn.Conv2d(24, widths[0], 3, padding=1)
        self.levels = nn.ModuleList(ResidualBlock(width) for width in (*widths, widths[-1]))
        self.downsamples = nn.ModuleList(nn.Sequential(ChannelNorm(a), nn.Conv2d(a, b, 2, stride=2)) for a, b in pairs)
        # The finest level has no decoder stage: the patch itself holds finer detail.
        self.skips = nn.ModuleList(SkipMerge(a, b) for a, b in pairs[1:])
        self.up_blocks = nn.ModuleList(ResidualBlock(a) for a, _ in pairs[1:])
        self.norm = ChannelNorm(widths[1])

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Straight rgb and matte [B, 4, S, S] to features [B, widths[1], S/4, S/4]."""
        rgb, matte = image[:, :3], image[:, 3:]
        across = torch.linspace(-1, 1, image.shape[-1], device=image.device).expand_as(matte)
        planes = [colour_code(rgb) * (matte > 0), matte, across, across.transpose(2, 3)]
        x = self.stem(F.pixel_unshuffle(torch.cat(planes, 1), 2))
        fine_features = []
        for number, level in enumerate(self.levels[:-1]):
            if number:
                fine_features.append(x)
                x = self.downsamples[number - 1](x)
            x = level(x)
        x = self.levels[-1](x)
        for skip, up_block, fine in zip(
            reversed(self.skips), reversed(self.up_blocks), reversed(fine_features[1:]), strict=True
        ):
            x = up_block(skip(fine, x))
        return self.norm(x)


def sample_at_patch(features: torch.Tensor, location: torch.Tensor, cells: int) -> torch.Tensor:
    """Samples features of the whole subject at the cells of a patch.

    Args:
        features: [B, C, h, w] over the square of the context image.
        location: [B, 3] top, left and side of the patch in units of the side of that square.
        cells: samples per side of the patch, at cell centres.

    Returns:
        [B, C, cells, cells], bilinear; beyond the square the nearest value.
    """
    steps = (torch.arange(cells, device=location.device) + 0.5) / cells
    rows = location[:, 0:1] + location[:, 2:] * steps
    columns = location[:, 1:2] + location[:, 2:] * steps
    grid = torch.stack([columns[:, None, :].expand(-1, cells, -1), rows[:, :, None].expand(-1, -1, cells)], -1)
    return F.grid_sample(features, 2 * grid - 1, mode="bilinear", padding_mode="border", align_corners=False)


class Estimator(nn.Module):
    """U-Net that maps rgb, matte and global context to the expected material and features, at half the resolution."""

    def __init__(self, shape: NetworkShape) -> None:
        super().__init__()
        widths = shape.widths
        pairs = list(pairwise(widths))
        self.stem = nn.Conv2d(16, widths[0], 3, padding=1)
        self.statistics = nn.Conv2d(STATISTICS, widths[0], 1)
        self.levels = nn.ModuleList(
            nn.Sequential(*(ResidualBlock(width) for _ in range(depth)))
            for width, depth in zip(widths, shape.depths, strict=True)
        )
        self.downsamples = nn.ModuleList(nn.Sequential(ChannelNorm(a), nn.Conv2d(a, b, 2, stride=2)) for a, b in pairs)
        self.context = ContextEncoder(shape.context)
        self.context_projection = nn.Conv2d(shape.context[1], widths[-2], 1)
        self.global_pooling = GlobalPooling(widths[-1])
        self.skips = nn.ModuleList(SkipMerge(a, b) for a, b in pairs)
        self.up_blocks = nn.ModuleList(ResidualBlock(a) for a, _ in pairs)
        self.out = nn.Sequential(ChannelNorm(widths[0]), nn.Conv2d(widths[0], shape.condition, 1))

    def forward(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """Estimates the materials of a patch.

        Args:
            rgb: [B, 3, P, P] linear Rec.709, straight.
            matte: [B, 1, P, P] coverage; P a multiple of 2^levels.
            context: image of the whole subject and location of the patch.

        Returns:
            [B, condition, P/2, P/2]; channels 0 and 1 are expected roughness and metallic, scaled from [0, 1] to [-1,
            1].
        """
        return self.from_features(rgb, matte, self.context(context.image), context.location)

    def from_features(
        self, rgb: torch.Tensor, matte: torch.Tensor, context: torch.Tensor, location: torch.Tensor
    ) -> torch.Tensor:
        """As `forward`, from features of the context encoder.

        Args:
            rgb: [B, 3, P, P] linear Rec.709, straight.
            matte: [B, 1, P, P] coverage.
            context: [B, C, h, w] features that `ContextEncoder` returned.
            location: [B, 3] location of the patch, as in `ContextBatch`.

        Returns:
            [B, condition, P/2, P/2], as in `forward`.
        """
        code = colour_code(rgb) * (matte > 0)
        with torch.no_grad():
            statistics = local_statistics(code, matte)
        x = self.stem(F.pixel_unshuffle(torch.cat([code, matte], 1), 2)) + self.statistics(statistics)
        fine = []
        for number, level in enumerate(self.levels):
            if number:
                fine.append(x)
                x = self.downsamples[number - 1](x)
            if number == len(self.levels) - 2:
                x = x + self.context_projection(sample_at_patch(context, location, x.shape[-1]))
            x = level(x)
        x = self.global_pooling(x, F.avg_pool2d(matte, matte.shape[-1] // x.shape[-1]))
        for skip, up_block, seen in zip(reversed(self.skips), reversed(self.up_blocks), reversed(fine), strict=True):
            x = up_block(skip(seen, x))
        return self.out(x)


class Denoiser(nn.Module):
    """One step of the sampler: maps noisy materials, smooth noise and condition to a sample of the clean materials.

    It is trained with the energy score (`yesnt.training.losses.energy_score`), a proper scoring rule. Its output is
    therefore a sample of p(x_0 | x_t, image) and not the mean; the smooth noise planes make samples differ.
    """

    def __init__(self, shape: NetworkShape) -> None:
        super().__init__()
        a, b = shape.denoiser
        time = 4 * a
        self.time = nn.Sequential(nn.Linear(2, time), nn.SiLU(), nn.Linear(time, time), nn.SiLU())
        self.stem = nn.Conv2d(8 + shape.smooth_planes + shape.denoiser_condition, a, 3, padding=1)
        self.down = nn.Conv2d(a, b, 2, stride=2)
        self.middle = nn.ModuleList([ResidualBlock(b, time) for _ in range(2)])
        self.skip, self.last = SkipMerge(a, b, PixelNorm), ResidualBlock(a, time)
        self.out = nn.Sequential(PixelNorm(a), nn.SiLU(), nn.Conv2d(a, 8, 3, padding=1))

    def forward(
        self, state: torch.Tensor, smooth: torch.Tensor, condition: torch.Tensor, time: torch.Tensor
    ) -> torch.Tensor:
        """Draws a sample of the clean materials.

        Args:
            state: [B, 2, P, P] x_t of about unit variance.
            smooth: [B, smooth_planes, P, P] standard normal, blurred.
            condition: [B, denoiser_condition, P/2, P/2]; channels 0 and 1 are the expected material in [-1, 1].
            time: [B] diffusion time in (0, 1]; 1 is pure noise.

        Returns:
            [B, 2, P, P] roughness and metallic, scaled from [0, 1] to [-1, 1], not clipped.
        """
        angle = time[:, None] * (torch.pi / 2)
        embedding = self.time(torch.cat([angle.sin(), angle.cos()], 1))
        inputs = torch.cat([F.pixel_unshuffle(state, 2), smooth[:, :, ::2, ::2], condition], 1)
        top = self.stem(inputs)
        middle = self.down(top)
        for block in self.middle:
            middle = block(middle, embedding)
        deviation = F.pixel_shuffle(self.out(self.last(self.skip(top, middle), embedding)), 2)
        # The network predicts the deviation from the mean, so it need not reproduce the mean from noise.
        return deviation + F.interpolate(condition[:, :2], scale_factor=2, mode="bilinear", align_corners=False)


class Network(nn.Module):
    """Estimator, denoiser and, if the shape says so, auxiliary predictor."""

    def __init__(self, shape: NetworkShape) -> None:
        super().__init__()
        self.shape = shape
        self.estimator = Estimator(shape)
        self.denoiser = Denoiser(shape)
        self.auxiliary = AuxiliaryPredictor(*shape.auxiliary) if shape.auxiliary else None


def noised(clean: torch.Tensor, noise: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """Diffuses clean values: x_t = cos(pi t / 2) x_0 + sin(pi t / 2) noise (variance preserving, cosine schedule).

    Args:
        clean: [B, 2, P, P] x_0.
        noise: [B, 2, P, P] standard normal.
        time: [B] in [0, 1].

    Returns:
        [B, 2, P, P] x_t.
    """
    angle = time[:, None, None, None] * (torch.pi / 2)
    return angle.cos() * clean + angle.sin() * noise
