"""Base colour of metals from all views, where the delivered view shows more lobe than body colour.

Relighting inverts the plate: a highlight that the model of the light puts beside its place, or with another width,
stays in the base colour. Other cameras see the point without it. The fit over all views is robust against highlights,
but it mixes pixels of several pictures. Both errors are predicted, and the fit counts by their ratio.

A dielectric keeps the plate's: its lobe has no colour, and what the inversion leaves in its base colour shows the plate
again under a like light, errors of normals and z included. docs/evidence.md says what
that is worth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.reference import LEAST_SQUARE
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight.albedo import multiple_scattering

F32 = NDArray[np.float32]
Float = NDArray[np.floating]

LEAST_VIEWS = 3
"""Views of a point from which a fit tells a highlight from a colour, the plate included."""

REACH = 2
"""Rows and columns from a pixel to the fitted ones that tell of it."""

METAL = (0.5, 0.9)
"""Metallic at which the fit over all views begins to count, and at which it counts fully."""

_ALIKE = 0.5  # difference of log colour at which a neighbour is another surface; metals differ from pixel to pixel
_DARK = 1e-3  # radiance that a logarithm is taken of, at least


def base_by_views(
    seen: Observations, of: Responses, levels: Float, materials: Float, settings: EvidenceSettings
) -> Float:
    """Base colour by all views and its weight against the plate's, [N, 4]; the weight is 0 where the plate's stands.

    The inversion's error is `lobe_error` of the plate's share of specular light, that of all views `sight_error`, both
    relative to the base colour; the fit's weight is the first squared over the sum of both squared, for metals alone.

    Args:
        seen: what V cameras saw of N points, the plate first.
        of: responses for R levels of roughness.
        levels: these levels [R].
        materials: [N, 2] roughness and metallic.
        settings: `steps`, `freedom`, `lobe_error` and `sight_error`.
    """
    lobes = _Lobes.at(of, levels, materials)
    alone = np.zeros_like(seen.valid)
    alone[:, 0] = seen.valid[:, 0]
    inverted, fitted = (
        lobes.base(seen._replace(valid=alone), None, settings),
        lobes.base(seen, settings.freedom, settings),
    )
    lobe = settings.lobe_error * lobes.specular_share(inverted)
    weight = lobe**2 / (lobe**2 + settings.sight_error**2)
    weight *= np.clip((materials[:, 1] - METAL[0]) / (METAL[1] - METAL[0]), 0, 1)
    known = seen.valid[:, 0] & (seen.valid.sum(axis=1) >= LEAST_VIEWS)
    return np.concatenate([fitted, np.where(known, weight, 0)[:, None]], axis=1)


@dataclass(frozen=True)
class _Lobes:
    """Responses of N points towards V cameras at a roughness and metallic each; [N, V, 3], missing [N, V, 1]."""

    diffuse: Float
    dielectric: Float
    f0: Float
    f90: Float
    missing: Float
    average: Float
    metallic: Float

    @classmethod
    def at(cls, of: Responses, levels: Float, materials: Float) -> _Lobes:
        """Between the two levels of roughness that each point lies between."""
        roughness = np.clip(materials[:, 0], levels[0], levels[-1])
        low = np.clip(np.searchsorted(levels, roughness) - 1, 0, len(levels) - 2)
        share = (roughness - levels[low]) / (levels[low + 1] - levels[low])
        point = np.arange(len(low))

        def between(values: F32) -> Float:
            part = share.reshape(-1, *(1,) * (values.ndim - 2))
            return np.asarray((1 - part) * values[point, :, low] + part * values[point, :, low + 1])

        average = (1 - share) * of.average[low] + share * of.average[low + 1]
        return cls(
            between(of.diffuse), between(of.dielectric), between(of.metal_f0), between(of.metal_f90),
            between(of.missing)[..., None], average[:, None], materials[:, 1, None, None],
        )  # fmt: skip

    def linear_form(self, base: Float) -> tuple[Float, Float]:
        """A and D [N, V, 3] (reference.linear_form)."""
        single = base + (1 - base) / 21
        factor = 1 + multiple_scattering(single, self.average)[:, None] * self.missing
        slope = (1 - self.metallic) * self.diffuse + self.metallic * factor * self.f0
        return slope, (1 - self.metallic) * self.dielectric + self.metallic * factor * self.f90

    def base(self, seen: Observations, freedom: float | None, settings: EvidenceSettings) -> Float:
        """Base colour [N, 3] in [0, 1] by least squares; robust with `freedom` (reference.best_base_color)."""
        inverse = seen.valid[..., None] / seen.sigma.astype(float) ** 2
        base, weight = np.full((len(seen.valid), 3), 0.5), np.ones(seen.radiance.shape)
        for _ in range(settings.steps):
            slope, offset = self.linear_form(base)
            w = weight * inverse * slope
            up, down = (w * (seen.radiance - offset)).sum(axis=1), (w * slope).sum(axis=1)
            base = np.clip(up / np.maximum(down, LEAST_SQUARE), 0, 1)
            if freedom is not None:
                slope, offset = self.linear_form(base)
                error = (seen.radiance - offset - base[:, None] * slope) / seen.sigma
                weight = (freedom + 1) / (freedom + error**2)
        return base

    def specular_share(self, base: Float) -> Float:
        """Share [N] of what the first camera is sent that does not come from the diffuse body."""
        slope, offset = self.linear_form(base)
        sent = (base * slope[:, 0] + offset[:, 0]).mean(axis=1)
        body = ((1 - self.metallic[:, 0]) * self.diffuse[:, 0] * base).mean(axis=1)
        return np.asarray(np.clip(1 - body / np.maximum(sent, LEAST_SQUARE), 0, 1))


def spread_over_pixels(known: F32, fitted: NDArray[np.bool_], plate: F32) -> F32:
    """Values [H, W, C] of fitted pixels for all: a mean over fitted neighbours of a similar colour in the plate.

    Args:
        known: [H, W, C]; read where fitted.
        fitted: [H, W].
        plate: [H, W, 3] radiance.
    """
    shade = np.log(np.maximum(np.nan_to_num(plate), _DARK)).astype(np.float32)
    values, there, color = (_padded(a) for a in (known, fitted[..., None].astype(np.float32), shade))
    total, weight = np.zeros_like(known), np.zeros((*fitted.shape, 1), np.float32)
    for down in range(-REACH, REACH + 1):
        for across in range(-REACH, REACH + 1):
            window = _Window(down, across, fitted.shape)
            apart = np.square(window.of(color) - shade).sum(axis=-1, keepdims=True) / _ALIKE**2
            near = window.of(there) * np.exp(-0.5 * (apart + down * down + across * across)).astype(np.float32)
            total += near * window.of(values)
            weight += near
    return np.asarray(total / np.maximum(weight, np.float32(1e-12)), np.float32)


def _padded(image: F32) -> F32:
    return np.pad(image, ((REACH, REACH), (REACH, REACH), (0, 0)))


@dataclass(frozen=True)
class _Window:
    """A padded image's pixels beside those of the image."""

    down: int
    across: int
    shape: tuple[int, ...]

    def of(self, padded: F32) -> F32:
        """[H, W, C] of an image that `_padded` made."""
        row, column = REACH + self.down, REACH + self.across
        return padded[row : row + self.shape[0], column : column + self.shape[1]]
