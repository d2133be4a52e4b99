"""All numbers of one relit picture against its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yesnt.color import srgb_encode
from yesnt.metrics.definitions import Metric, named
from yesnt.metrics.flip import exposure_range, flip_map, hdr_flip_map
from yesnt.metrics.image import channel_scale, psnr, ssim_map
from yesnt.metrics.perceptual import Features, PerceptualNet

F32 = NDArray[np.float32]

SOLID = 0.99
"""Coverage above which a pixel counts as inside the matte."""


@dataclass(frozen=True)
class Truth:
    """A true picture, and what is measured of it once for all candidates.

    Attributes:
        radiance: [H, W, 3] straight, scene-linear.
        opacity: [H, W] coverage.
        inside: [H, W] the pixels that masked numbers count.
        nets: perceptual networks that are at hand.
    """

    radiance: F32
    opacity: F32
    inside: NDArray[np.bool_]
    nets: Sequence[PerceptualNet] = ()

    @classmethod
    def of(cls, radiance: F32, opacity: F32, matte: F32, nets: Sequence[PerceptualNet] = ()) -> Truth:
        """A truth whose inside is solid both in itself and in the plate's matte."""
        return cls(radiance, opacity, (opacity > SOLID) & (matte > SOLID), nets)

    def shown(self, radiance: NDArray[np.floating]) -> NDArray[np.floating]:
        """A straight picture as it is displayed over black, with the truth's coverage."""
        return srgb_encode(np.asarray(radiance, np.float32) * self.opacity[..., None])

    @cached_property
    def display(self) -> NDArray[np.floating]:
        """The truth as displayed over black."""
        return self.shown(self.radiance)

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
        rows, columns = (np.flatnonzero(self.inside.any(axis=axis)) for axis in (1, 0))
        return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)

    def boxed(self, display: NDArray[np.floating]) -> NDArray[np.floating]:
        """A display picture cut to the box, black outside the matte."""
        return (display * self.inside[..., None])[self.box]

    @cached_property
    def features(self) -> list[tuple[Features, Features]]:
        """Of every net: features of the whole truth and of its box."""
        return [(net.features(self.display), net.features(self.boxed(self.display))) for net in self.nets]


def score(radiance: NDArray[np.floating], truth: Truth) -> list[Metric]:
    """Every number of a straight scene-linear picture [H, W, 3], as it is and with its channels scaled to the truth's.

    An opacity is not scored: the plate's matte is what all rows share, and the truth's is used for all.
    """
    scale = channel_scale(radiance, truth.radiance, truth.inside).astype(np.float32)
    plain = _score_once(np.asarray(radiance, np.float32), truth)
    aligned = _score_once(np.asarray(radiance, np.float32) * scale, truth)
    found = [named(name, value) for name, value in plain.items()]
    found += [named(f"{name}_aligned", value) for name, value in aligned.items() if not _only_plain(name)]
    error = hdr_flip_map(np.maximum(radiance, 0) * _solid(truth), truth.radiance * _solid(truth), truth.exposures)
    return [*found, named("hdr_flip", float(error[truth.inside].mean()))]


def _only_plain(name: str) -> bool:
    return name.endswith(("_whole", "_matte"))


def _solid(truth: Truth) -> F32:
    return truth.opacity[..., None]


def _score_once(radiance: F32, truth: Truth) -> dict[str, float]:
    inside, display = truth.inside, truth.shown(radiance)
    similarity, flip = ssim_map(display, truth.display), flip_map(display, truth.display)
    found = {
        "psnr": psnr(srgb_encode(radiance), srgb_encode(truth.radiance), inside),
        "psnr_whole": psnr(display, truth.display),
        "psnr_linear": psnr(radiance, truth.radiance, inside, truth.peak),
        "ssim": float(similarity[inside].mean()),
        "ssim_whole": float(similarity.mean()),
        "flip": float(flip[inside].mean()),
        "flip_whole": float(flip.mean()),
    }
    for net, (whole, box) in zip(truth.nets, truth.features, strict=True):
        found[net.name] = net.between(net.features(display), whole)
        found[f"{net.name}_matte"] = net.between(net.features(truth.boxed(display)), box)
    return found
