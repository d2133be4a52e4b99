"""The embedded model's network: a U-Net that reads the picture once and a small one that turns noise into materials."""

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
from yesnt.decompose.statistics import STATISTICS, colour_code, surroundings


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of the network.

    Attributes:
        widths: channels of the reading U-Net at 1/2, 1/4, 1/8, ... of the resolution.
        depths: residual blocks per level on the way down.
        condition: channels handed to the denoiser at 1/2 resolution, the two of the expected material among them.
        denoiser: channels of the denoiser at 1/2 and 1/4 resolution.
        smooth_planes: noise planes besides the two of the state.
        context: channels of the U-Net that reads the whole subject, at 1/2, 1/4, ... of the small picture.
        auxiliary: hidden channels of the perceptron that gives a second opinion; none: there is no second opinion.
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
        """Channels of what the denoiser is told: with a second opinion also how far the two are apart."""
        return self.condition + (2 if self.auxiliary else 0)

    def header(self) -> str:
        """The sizes as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_header(cls, text: str) -> NetworkShape:
        """Reads what `header` wrote."""
        values: dict[str, Any] = json.loads(text)
        return cls(**{name: _frozen(value) for name, value in values.items()})


def _frozen(value: Any) -> Any:
    """JSON's lists as tuples."""
    return tuple(value) if isinstance(value, list) else value


class PixelNorm(nn.LayerNorm):
    """Layer norm over the channels of each pixel: a patch's empty surroundings do not enter, unlike with group norm.

    No scale and shift of its own: the convolution that follows has them, and their gradients, sums over all pixels, are
    wrong by half in bfloat16.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, elementwise_affine=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[B, C, h, w] -> the same."""
        return super().forward(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class Norm(nn.BatchNorm2d):
    """Norm of the estimator: each channel over all pixels of a training batch, as a fixed scale afterwards.

    A norm over the channels of a pixel let one common vector grow in the coarse levels until nothing else was left of
    them (`tests/benchmarks/decompose_estimator.py` silences each): the network then saw colours and no shapes. Here every
    channel has to vary. A row's result depends on that row alone, since what is used is the running statistics.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, momentum=0.05)


class ResidualBlock(nn.Module):
    """Residual block of two 3x3 convolutions; `time` scales and shifts the middle (0 channels: not conditioned)."""

    def __init__(self, channels: int, time_channels: int = 0) -> None:
        super().__init__()
        self.norm = PixelNorm(channels) if time_channels else Norm(channels)
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.modulation = nn.Linear(time_channels, 2 * channels) if time_channels else None
        nn.init.zeros_(self.second.weight)

    def forward(self, x: torch.Tensor, time: torch.Tensor | None = None) -> torch.Tensor:
        """[B, C, h, w] -> the same."""
        middle = self.first(self.norm(x))
        if self.modulation is not None and time is not None:
            scale, shift = self.modulation(time)[:, :, None, None].chunk(2, 1)
            middle = middle * (1 + scale) + shift
        return x + self.second(F.silu(middle))


class SkipMerge(nn.Module):
    """Brings coarse features up to a finer level and joins them with what that level saw itself."""

    def __init__(self, fine: int, coarse: int, norm: type[nn.Module] = Norm) -> None:
        super().__init__()
        self.norm_fine, self.norm_coarse = norm(fine), norm(coarse)
        self.fine = nn.Conv2d(fine, fine, 3, padding=1)
        self.coarse = nn.Conv2d(coarse, fine, 1)

    def forward(self, fine: torch.Tensor, coarse: torch.Tensor) -> torch.Tensor:
        """[B, F, 2h, 2w] and [B, C, h, w] to [B, F, 2h, 2w].

        Both are normalised first: coarse features grow louder and would drown the edges.
        """
        raised = F.interpolate(self.coarse(self.norm_coarse(coarse)), scale_factor=2, mode="nearest")
        return F.silu(self.fine(self.norm_fine(fine)) + raised)


class GlobalPooling(nn.Module):
    """Tells every place of the coarsest level what the patch shows on the whole, over the matte."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = Norm(channels)
        last = nn.Linear(channels, channels)
        nn.init.zeros_(last.weight)
        self.mix = nn.Sequential(nn.Linear(channels, channels), nn.SiLU(), last)

    def forward(self, x: torch.Tensor, cover: torch.Tensor) -> torch.Tensor:
        """[B, C, h, w] and coverage [B, 1, h, w] to [B, C, h, w]."""
        mean = (self.norm(x) * cover).sum((2, 3)) / cover.sum((2, 3)).clamp_min(1e-3)
        return x + self.mix(mean)[:, :, None, None]


class ContextEncoder(nn.Module):
    """Reads the whole subject in small; its features say of a patch where on the subject it lies."""

    def __init__(self, widths: tuple[int, ...]) -> None:
        super().__init__()
        pairs = list(pairwise(widths))
        self.stem = nn.Conv2d(24, widths[0], 3, padding=1)
        self.levels = nn.ModuleList(ResidualBlock(width) for width in (*widths, widths[-1]))
        self.downsamples = nn.ModuleList(nn.Sequential(Norm(a), nn.Conv2d(a, b, 2, stride=2)) for a, b in pairs)
        # The finest level is read on the way down only: a patch knows its own detail.
        self.skips = nn.ModuleList(SkipMerge(a, b) for a, b in pairs[1:])
        self.up_blocks = nn.ModuleList(ResidualBlock(a) for a, _ in pairs[1:])
        self.norm = Norm(widths[1])

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        """[B, 4, S, S] straight rgb and matte to [B, widths[1], S/4, S/4]."""
        rgb, matte = picture[:, :3], picture[:, 3:]
        across = torch.linspace(-1, 1, picture.shape[-1], device=picture.device).expand_as(matte)
        planes = [colour_code(rgb) * (matte > 0), matte, across, across.transpose(2, 3)]
        x = self.stem(F.pixel_unshuffle(torch.cat(planes, 1), 2))
        seen = []
        for number, level in enumerate(self.levels[:-1]):
            if number:
                seen.append(x)
                x = self.downsamples[number - 1](x)
            x = level(x)
        x = self.levels[-1](x)
        for skip, up_block, fine in zip(
            reversed(self.skips), reversed(self.up_blocks), reversed(seen[1:]), strict=True
        ):
            x = up_block(skip(fine, x))
        return self.norm(x)


def at_patch(features: torch.Tensor, place: torch.Tensor, cells: int) -> torch.Tensor:
    """Features of the whole at the places of a patch's cells.

    Args:
        features: [B, C, h, w] over the small picture.
        place: [B, 3] top, left and side of the patch in sides of that picture.
        cells: per side of the patch.

    Returns:
        [B, C, cells, cells]; beyond the picture's edge its nearest value.
    """
    steps = (torch.arange(cells, device=place.device) + 0.5) / cells
    rows = place[:, 0:1] + place[:, 2:] * steps
    columns = place[:, 1:2] + place[:, 2:] * steps
    grid = torch.stack([columns[:, None, :].expand(-1, cells, -1), rows[:, :, None].expand(-1, -1, cells)], -1)
    return F.grid_sample(features, 2 * grid - 1, mode="bilinear", padding_mode="border", align_corners=False)


class Estimator(nn.Module):
    """RGB and matte to what is expected and features, at half the resolution."""

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
        self.downsamples = nn.ModuleList(nn.Sequential(Norm(a), nn.Conv2d(a, b, 2, stride=2)) for a, b in pairs)
        self.context = ContextEncoder(shape.context)
        self.context_projection = nn.Conv2d(shape.context[1], widths[-2], 1)
        self.global_pooling = GlobalPooling(widths[-1])
        self.skips = nn.ModuleList(SkipMerge(a, b) for a, b in pairs)
        self.up_blocks = nn.ModuleList(ResidualBlock(a) for a, _ in pairs)
        self.out = nn.Sequential(Norm(widths[0]), nn.Conv2d(widths[0], shape.condition, 1))

    def forward(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """Reads a patch.

        Args:
            rgb: [B, 3, P, P] linear.
            matte: [B, 1, P, P]; P a multiple of 2^levels.
            context: the whole subject, and where on it the patch lies.

        Returns:
            [B, condition, P/2, P/2]; channels 0 and 1 are the expected roughness and metallic, -1 .. 1 for 0 .. 1.
        """
        return self.from_features(rgb, matte, self.context(context.image), context.location)

    def from_features(
        self, rgb: torch.Tensor, matte: torch.Tensor, whole: torch.Tensor, place: torch.Tensor
    ) -> torch.Tensor:
        """As `forward`, with the features of the whole [B, C, h, w] at hand."""
        code = colour_code(rgb) * (matte > 0)
        with torch.no_grad():
            statistics = surroundings(code, matte)
        x = self.stem(F.pixel_unshuffle(torch.cat([code, matte], 1), 2)) + self.statistics(statistics)
        fine = []
        for number, level in enumerate(self.levels):
            if number:
                fine.append(x)
                x = self.downsamples[number - 1](x)
            if number == len(self.levels) - 2:
                x = x + self.context_projection(at_patch(whole, place, x.shape[-1]))
            x = level(x)
        x = self.global_pooling(x, F.avg_pool2d(matte, matte.shape[-1] // x.shape[-1]))
        for skip, up_block, seen in zip(reversed(self.skips), reversed(self.up_blocks), reversed(fine), strict=True):
            x = up_block(skip(seen, x))
        return self.out(x)


class Denoiser(nn.Module):
    """One step: noisy materials, smooth noise and condition to a draw of clean materials.

    It is trained with a proper scoring rule (`training/losses.py`), hence its output is a sample of
    p(x0 | x_t, picture), not the mean. The smooth noise planes make draws differ.
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
        """SamplePairs clean materials.

        Args:
            state: [B, 2, P, P] x_t, about unit variance.
            smooth: [B, smooth_planes, P, P] noise.
            condition: [B, told, P/2, P/2].
            time: [B] in (0, 1], 1 is pure noise.

        Returns:
            [B, 2, P, P], -1 .. 1 stands for 0 .. 1 of the materials.
        """
        angle = time[:, None] * (torch.pi / 2)
        embedding = self.time(torch.cat([angle.sin(), angle.cos()], 1))
        inputs = torch.cat([F.pixel_unshuffle(state, 2), smooth[:, :, ::2, ::2], condition], 1)
        top = self.stem(inputs)
        middle = self.down(top)
        for block in self.middle:
            middle = block(middle, embedding)
        change = F.pixel_shuffle(self.out(self.last(self.skip(top, middle), embedding)), 2)
        # SamplePairs spread about what the estimator predicts_mean; the noise need not carry what is known already.
        return change + F.interpolate(condition[:, :2], scale_factor=2, mode="bilinear", align_corners=False)


class Network(nn.Module):
    """Estimator and denoiser together, and who is asked for a second opinion."""

    def __init__(self, shape: NetworkShape) -> None:
        super().__init__()
        self.shape = shape
        self.estimator = Estimator(shape)
        self.denoiser = Denoiser(shape)
        self.auxiliary = AuxiliaryPredictor(*shape.auxiliary) if shape.auxiliary else None


def noised(clean: torch.Tensor, noise: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """x_t = cos(pi t / 2) x_0 + sin(pi t / 2) noise (variance preserving, cosine schedule); time [B]."""
    angle = time[:, None, None, None] * (torch.pi / 2)
    return angle.cos() * clean + angle.sin() * noise
