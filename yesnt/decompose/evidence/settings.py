"""Settings of the evidence, and the grid of candidates (docs/method.md section 3b)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

ROUGHNESS = (0.05, 0.12, 0.2, 0.3, 0.42, 0.56, 0.75, 1.0)
"""Candidates of roughness: dense where a lobe changes quickly."""

METALLIC = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Candidates of metallic."""

_RANGES = {
    "roughness_levels": (2, 64), "metallic_levels": (2, 64), "radius": (0, 64), "least_views": (1, 256),
    "normal_error": (0, 30), "steps": (1, 64), "passes": (1, 16), "independent": (1, 1_000_000),
    "tile": (64, 1_000_000),
}  # fmt: skip

METALLIC_PRIOR = (0.0023, 0.0213)
"""Parameters a, b of a Beta distribution, fitted to the metallic of 400,000 pixels that the generator of training data
draws (tests/benchmarks/evidence_prior.py): 90 % are none, 9 % are metal."""

HALF_METALS = 0.15
"""Share of surfaces of any metallic, as likely as another: patina, paint over metal, pixels that mix two materials. The
generator draws few of them."""

METAL_LUMINANCE = (0.59, 0.57)
"""Median luminance of the base colour of the generator's metals, and the standard deviation of its logarithm."""

DARKEST_METAL = 4.6
"""Most that darkness tells against a metal, in log probability: one metal of a hundred is of any luminance."""


@dataclass(frozen=True)
class EvidenceSettings:
    """How observations are weighed.

    Attributes:
        relative: standard deviation of an observation over its value: what the model of the light leaves unexplained.
        floor: the same, over the mean radiance of the capture light, which black pixels keep.
        indirect: standard deviation of the light that comes from the subject itself, over its value: what a mirror
            shows of its neighbours is known from a mean over triangles.
        sharpness: exponent of the lobe about the mirrored view that tells how much of what a point shows comes from
            the subject itself.
        edge: share of the deviation within 3 x 3 pixels that counts as uncertainty: a camera's point is off by a part
            of a pixel.
        freedom: degrees of freedom of Student's t distribution, which lets a highlight contradict the others.
        steps: steps of reweighted least squares.
        cosine: least cosine between normal and direction to a camera.
        covered: least coverage of the four pixels around an observation.
        depth: difference between a point's depth and the proxy's that counts as the same surface, over the size of the
            proxy.
        least_views: cameras below which a pixel keeps the model's estimate.
        step: rows and columns of the cells of which one pixel is fitted; the others are pooled from those. It divides
            the 4 rows that bands of pixels are cut at (relight/sparse.py). 1 fits every pixel.
        radius: pixels from the middle of the pooling window to its border.
        window: standard deviation of the window's weights, pixels.
        chroma: difference of log colour at which a neighbour counts as another material.
        pattern: the same of the way that intensity differs from camera to camera; wide, since it turns with the normal.
        intensity: the same of log intensity; large, since shading changes it too.
        turn: difference of unit normals at which a neighbour counts as another surface.
        apart: distance to the plane of the pixel at which a neighbour counts as another surface, in widths of a pixel.
        contrary: what two points lose together, in log likelihood of a point, each at the best candidate of the other,
            at which they count as two materials.
        temper: the mean of the pooled log likelihoods is divided by this: neighbours are not independent.
        unknown: standard deviation of roughness that wrong normals, visibility and light leave however well the cameras
            agree; added to the posterior's.
        stretch: factor of both standard deviations. Both were chosen so that 68 % of errors lie within one standard
            deviation over all rungs of tests/benchmarks/evidence_objects.py.
        roughness_error: error of the model's roughness beyond the spread of its members.
        metallic_error: the same of metallic.
        normal_error: standard deviation of the turn of a normal about each of two axes, degrees; the turn is an unknown
            of the fit. 0 takes normals as they are.
        lobe_error: error of the base colour that the plate alone gives, relative, where all light is specular.
        sight_error: the same of the base colour that all views give.
        gain_error: standard deviation of a camera's gain in a channel, of its logarithm; 0 takes gains as they are.
        light_error: standard deviation of the smooth factor of the capture light; 0 takes the map as it is.
        independent: points that tell about gains and light as if they were independent; the others repeat them.
        passes: times that gains and light are fitted.
        roughness_levels: candidates of roughness, at least 2; other numbers than 8 are spread as `ROUGHNESS` is.
        metallic_levels: candidates of metallic, evenly spread, at least 2.
        tile: pixels that are measured together; bounds memory.
        engine: "numba" on the processor; "torch" on CUDA if there is one: responses and likelihood, equal to rounding.
    """

    relative: float = 0.05
    floor: float = 0.004
    indirect: float = 0.5
    sharpness: float = 60.0
    edge: float = 0.25
    freedom: float = 4.0
    steps: int = 4
    cosine: float = 0.15
    covered: float = 0.99
    depth: float = 0.012
    least_views: int = 2
    step: int = 2
    radius: int = 10
    window: float = 5.0
    chroma: float = 0.15
    pattern: float = 0.6
    intensity: float = 0.67
    turn: float = 0.5
    apart: float = 4.0
    contrary: float = 10.0
    temper: float = 0.15
    unknown: float = 0.12
    stretch: float = 1.1
    roughness_error: float = 0.23
    metallic_error: float = 0.6
    normal_error: float = 3.0
    lobe_error: float = 0.2
    sight_error: float = 0.05
    gain_error: float = 0.05
    light_error: float = 0.1
    independent: int = 25
    passes: int = 2
    roughness_levels: int = len(ROUGHNESS)
    metallic_levels: int = len(METALLIC)
    tile: int = 4096
    engine: Literal["numba", "torch"] = "numba"

    def __post_init__(self) -> None:
        """Checks the ranges.

        Raises:
            ValueError: a field is out of its range; names it.
        """
        for field in fields(self):
            if isinstance(field.default, int) and type(getattr(self, field.name)) is not int:
                raise ValueError(f"{field.name} {getattr(self, field.name)} must be a whole number")
        for name, choices in (("engine", ("numba", "torch")), ("step", (1, 2, 4))):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} {getattr(self, name)} must be one of {', '.join(map(str, choices))}")
        for name, (low, high) in _RANGES.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} {getattr(self, name)} must be in {low} .. {high}")
        for name in (
            "relative",
            "floor",
            "freedom",
            "temper",
            "window",
            "chroma",
            "pattern",
            "intensity",
            "turn",
            "contrary",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} {getattr(self, name)} must be above 0")


OFFSETS = (1, -1, 2, -2, 4, -4, 8, -8)
"""Frames from a frame to those that measure it over time, the nearest first: wider ones turn the subject further, and
the flow reaches fewer of their pixels."""


Levels = np.ndarray[tuple[int], np.dtype[np.float64]]


def roughness_levels(settings: EvidenceSettings) -> Levels:
    """Candidates [R]: `ROUGHNESS`, or as many as are asked for, between its values in equal steps of its index."""
    place = np.linspace(0, len(ROUGHNESS) - 1, settings.roughness_levels)
    return np.interp(place, np.arange(len(ROUGHNESS)), ROUGHNESS)


def metallic_levels(settings: EvidenceSettings) -> Levels:
    """Candidates [M] from 0 to 1; by default `METALLIC`."""
    return np.linspace(0.0, 1.0, settings.metallic_levels)
