"""All metrics of one relit picture against its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.metrics.definitions import Metric, named
from yesnt.metrics.flip import exposure_range, flip_map, hdr_flip_map
from yesnt.metrics.image import channel_scale, decibels, mean_squared_error, psnr, ssim_map
from yesnt.metrics.perceptual import Features, PerceptualNet

F32 = NDArray[np.float32]

SOLID = 0.99
"""Coverage above which a pixel counts as inside the matte."""

_MARGIN = 24
"""Pixels: wider than any filter of SSIM (5) and FLIP (10) at the default viewing distance."""


@dataclass(frozen=True)
class Truth:
    """A true picture, and everything that is computed from it once for all candidates.

    Attributes:
        radiance: [H, W, 3] straight, scene-linear.
        opacity: [H, W] coverage.
        inside: [H, W] pixels of the masked metrics.
        nets: perceptual networks whose weights are present.
    """

    radiance: F32
    opacity: F32
    inside: NDArray[np.bool_]
    nets: Sequence[PerceptualNet] = ()

    @classmethod
    def of(cls, radiance: F32, opacity: F32, matte: F32, nets: Sequence[PerceptualNet] = ()) -> Truth:
        """A truth whose inside is solid both in itself and in the plate's matte."""
        return cls(radiance, opacity, (opacity > SOLID) & (matte > SOLID), nets)

    def shown(self, radiance: NDArray[np.floating], opacity: F32 | None = None) -> NDArray[np.floating]:
        """A straight picture as it is displayed over black, with the truth's coverage or its own [H, W]."""
        coverage = self.opacity if opacity is None else opacity
        return srgb_encode(np.asarray(radiance, np.float32) * coverage[..., None])

    @cached_property
    def display(self) -> NDArray[np.floating]:
        """The truth as displayed over black."""
        return self.shown(self.radiance)

    @cached_property
    def frame(self) -> tuple[slice, slice]:
        """Box of the opacity with `_MARGIN` pixels around it; outside, both pictures are black and cannot differ."""
        return box_of(self.opacity > 0, _MARGIN)

    @cached_property
    def peak(self) -> float:
        """99th percentile of the linear values inside: the peak of linear PSNR."""
        return max(float(np.percentile(self.radiance[self.inside], 99)), 1e-6)

    @cached_property
    def exposures(self) -> tuple[float, ...]:
        """Exposures of HDR-FLIP."""
        return exposure_range(np.maximum(self.radiance[self.inside], 1e-6))

    @cached_property
    def box(self) -> tuple[slice, slice]:
        """Bounding box of the inside."""
        return box_of(self.inside, 0)

    def boxed(self, display: NDArray[np.floating]) -> NDArray[np.floating]:
        """A display picture cut to the box, black outside the matte."""
        return (display * self.inside[..., None])[self.box]

    @cached_property
    def features(self) -> list[tuple[Features, Features]]:
        """Features of the whole truth and of its box, for every network."""
        return [(net.features(self.display), net.features(self.boxed(self.display))) for net in self.nets]


def box_of(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold the mask, widened; all of the picture if the mask is empty."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(None), slice(None)
    return tuple(slice(max(0, int(i[0]) - margin), int(i[-1]) + 1 + margin) for i in (rows, columns))  # type: ignore[return-value]


def score(radiance: NDArray[np.floating], truth: Truth) -> list[Metric]:
    """Every metric of a straight scene-linear picture [H, W, 3], unscaled and with its channels scaled to the truth.

    Coverage is not scored: the truth's is used for both pictures.
    """
    picture = np.asarray(radiance, np.float32)
    scale = channel_scale(picture, truth.radiance, truth.inside).astype(np.float32)
    found = [named(name, value) for name, value in (_basic(picture, truth) | _perceptual(picture, truth)).items()]
    aligned = _basic(picture * scale, truth) | _perceptual(picture * scale, truth, boxed=False)
    found += [named(f"{name}_aligned", value) for name, value in aligned.items() if not name.endswith("_whole")]
    part, solid = truth.frame, truth.opacity[truth.frame][..., None]
    error = hdr_flip_map(np.maximum(picture[part], 0) * solid, truth.radiance[part] * solid, truth.exposures)
    return [*found, named("hdr_flip", float(error[truth.inside[part]].mean()))]


def score_briefly(radiance: NDArray[np.floating], truth: Truth, opacity: F32 | None = None) -> list[Metric]:
    """The cheap metrics of `score`: PSNR, SSIM and FLIP, and PSNR with the channels scaled.

    Args:
        radiance: [H, W, 3] straight, scene-linear.
        truth: the true picture.
        opacity: the picture's own coverage [H, W], which is then scored too, over black; None: the truth's is used.
    """
    picture = np.asarray(radiance, np.float32)
    seen = _seen(picture, opacity)
    scale = channel_scale(seen, truth.radiance, truth.inside).astype(np.float32)
    aligned = psnr(srgb_encode(seen * scale), srgb_encode(truth.radiance), truth.inside)
    found = _basic(picture, truth, opacity)
    return [*(named(name, value) for name, value in found.items()), named("psnr_aligned", aligned)]


def _seen(radiance: F32, opacity: F32 | None) -> F32:
    """What is seen at solid pixels [H, W, 3]: the colour itself, or what its own coverage leaves of it over black."""
    return radiance if opacity is None else radiance * opacity[..., None]


def _basic(radiance: F32, truth: Truth, opacity: F32 | None = None) -> dict[str, float]:
    part = truth.frame if opacity is None else (slice(None), slice(None))  # own coverage may reach anywhere
    display, true, inside = truth.shown(radiance, opacity)[part], truth.display[part], truth.inside[part]
    seen = _seen(radiance, opacity)
    similarity, flip = ssim_map(display, true), flip_map(display, true)
    share = inside.size / truth.inside.size  # outside `frame` SSIM is 1 and FLIP and the error are 0
    return {
        "psnr": psnr(srgb_encode(seen), srgb_encode(truth.radiance), truth.inside),
        "psnr_whole": decibels(share * mean_squared_error(display, true)),
        "psnr_linear": psnr(seen, truth.radiance, truth.inside, truth.peak),
        "ssim": float(similarity[inside].mean()),
        "ssim_whole": 1 - share * (1 - float(similarity.mean())),
        "flip": float(flip[inside].mean()),
        "flip_whole": share * float(flip.mean()),
    }


def _perceptual(radiance: F32, truth: Truth, boxed: bool = True) -> dict[str, float]:
    display, found = truth.shown(radiance), {}
    for net, (whole, box) in zip(truth.nets, truth.features, strict=True):
        found[net.name] = net.between(net.features(display), whole)
        if boxed:
            found[f"{net.name}_matte"] = net.between(net.features(truth.boxed(display)), box)
    return found
