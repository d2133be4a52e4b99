"""Predicts the time and the memory of a fit from its settings and the sizes of its pictures.

The constants were measured on one core of a 2.6 GHz server processor (docs/gaussians.md): a step costs so much for each
Gaussian and for each pixel of the crop that it looks at.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from yesnt.gaussians.settings import FitSettings

STEP, PER_GAUSSIAN, PER_PIXEL = 1e-3, 1.9e-6, 8e-7
"""Seconds of a step, of each Gaussian in it, of each pixel of the crop."""

LOOK_SHARE = 0.5
"""Cost of a picture that is only rendered and compared, of a step's."""

BEGIN = 1.5
"""Seconds in which the hull is carved, and a kernel or two is loaded."""

PER_READ = 3e-7
"""Seconds of each pixel of a whole picture: it is read, made linear, encoded and its silhouette's distances found."""

RESIDENT = 430e6
"""Bytes of a process that has loaded the kernels."""

PICTURE, CROP, RASTER, READING = 16, 20, 300, 60
"""Bytes of a pixel: of a whole picture, of a crop at both resolutions, of the crop in work, of a picture being read."""

PLANES = 3
"""Arrays of a fit per value of a Gaussian: the value, and Adam's two moments."""

WORKING = 600
"""Bytes of a Gaussian while it is rendered and differentiated."""


@dataclass(frozen=True)
class FitLoad:
    """What a fit looks at.

    Attributes:
        cameras: that are fitted.
        held_out: that only measure.
        whole: pixels of a picture, mean over the cameras.
        crop: pixels of a picture's part around the subject, mean over the cameras.
    """

    cameras: int
    held_out: int
    whole: float
    crop: float


def count_at(step: int, settings: FitSettings) -> int:
    """Gaussians at a step, if every round of splitting is used to the full and nothing is pruned."""
    first, last = (share * settings.steps for share in (settings.split_from, settings.split_until))
    rounds = sum(first <= at - 1 <= last for at in range(settings.every, step + 1, settings.every))
    return int(min(settings.count * (1 + settings.growth) ** rounds, max(settings.most, settings.count)))


def fit_seconds(settings: FitSettings, load: FitLoad) -> float:
    """Processor seconds of a fit that is not ended early."""
    steps = sum((stop - start) * _step(settings, load, start) for start, stop in _spans(settings))
    looks = -(-settings.steps // settings.check)
    look = LOOK_SHARE * (STEP + PER_GAUSSIAN * count_at(settings.steps, settings) + PER_PIXEL * load.crop)
    return BEGIN + PER_READ * (load.cameras + load.held_out) * load.whole + steps + looks * load.held_out * look


def fit_bytes(settings: FitSettings, load: FitLoad) -> float:
    """Most resident memory of a worker that fits."""
    pictures = (load.cameras + load.held_out) * (PICTURE * load.whole + CROP * load.crop)
    floats = 11 + 3 * (settings.degree + 1) ** 2
    gaussians = count_at(settings.steps, settings) * (4 * PLANES * floats + WORKING)
    return RESIDENT + pictures + gaussians + max(READING * load.whole, RASTER * load.crop)


def _spans(settings: FitSettings) -> Iterator[tuple[int, int]]:
    """Runs of steps between which neither the Gaussians nor the resolution change."""
    cuts = {*range(0, settings.steps, settings.every), math.ceil(settings.half * settings.steps), settings.steps}
    yield from zip(sorted(cuts)[:-1], sorted(cuts)[1:], strict=True)


def _step(settings: FitSettings, load: FitLoad, step: int) -> float:
    pixels = load.crop / 4 if step < settings.half * settings.steps else load.crop
    return STEP + PER_GAUSSIAN * count_at(step, settings) + PER_PIXEL * pixels
