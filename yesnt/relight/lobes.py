"""The four lobes of one pixel, summed over rows of texels, eight or more texels to a vector instruction.

The terms of the BRDF are in relight/microfacet.py. A texel is a disc and not a point: D is averaged over the disc of
half vectors that the texel covers. So no lobe falls between texels, however sharp, and its tail does not grow with the
size of the texels.

Lobe sums are [20] float32: irradiance, dielectric, F0 and F90 part of the metallic lobe, R, G, B each; the same four
sums of luminance without occlusion; the same four sums of uniform radiance 1.

Texels are counted with unsigned integers: for an index that might be negative LLVM emits gathers.
"""

from __future__ import annotations

import math

import numpy as np

from yesnt.relight.compiled import inlined, kernel
from yesnt.relight.microfacet import (
    disney_diffuse,
    fresnel_dielectric,
    fresnel_schlick_weight,
    half_vector,
    half_vector_broad,
    inverse_ggx_d,
    inverse_ggx_d_first_order,
    inverse_smith_g2,
    microfacet_lobe,
    smith_view_term,
)
from yesnt.relight.records import BLUE, DISNEY, GREEN, LAMBERT, RED, SOLID_ANGLE, SPREAD, X, Y, Z
from yesnt.relight.shading_frame import Vector, dot, load_frame

_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)
_INV_2PI = np.float32(0.5 / math.pi)


@inlined
def _direction(rows, t):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Unit direction of a texel."""
    return Vector(rows[X, t], rows[Y, t], rows[Z, t])


@inlined
def _twice_view(frame):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """2 v of a ShadingFrame, bent above the horizon as cos_o is."""
    n, t, cos_2, sin_2 = frame.normal, frame.tangent, _TWO * frame.cos_o, _TWO * frame.sin_o
    return Vector(cos_2 * n.x + sin_2 * t.x, cos_2 * n.y + sin_2 * t.y, cos_2 * n.z + sin_2 * t.z)


@kernel
def _add_lambert(stored_frame, rows, first, last, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds Lambert's diffuse lobe: cos_i of every texel."""
    frame = load_frame(stored_frame)
    red = green = blue = white = _ZERO
    for t in range(first, last):
        weight = max(dot(frame.normal, _direction(rows, t)), _ZERO)
        red += weight * rows[RED, t]
        green += weight * rows[GREEN, t]
        blue += weight * rows[BLUE, t]
        white += weight * rows[SOLID_ANGLE, t]
    sums[0] += red
    sums[1] += green
    sums[2] += blue
    sums[16] += white


@kernel
def _add_disney(stored_frame, rows, first, last, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds Burley's diffuse lobe."""
    frame = load_frame(stored_frame)
    half_roughness, weight_o = _HALF * math.sqrt(frame.alpha), (_ONE - frame.cos_o) ** 5
    red = green = blue = white = _ZERO
    for t in range(first, last):
        weight = disney_diffuse(half_vector(frame, _direction(rows, t)), half_roughness, weight_o)
        red += weight * rows[RED, t]
        green += weight * rows[GREEN, t]
        blue += weight * rows[BLUE, t]
        white += weight * rows[SOLID_ANGLE, t]
    sums[0] += red
    sums[1] += green
    sums[2] += blue
    sums[16] += white


@inlined
def _narrow(frame, view2, a2, view_term, light, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """2 pi D G2 / (4 cos_o) of one texel and q = |l + v|^2, for lobes of any width."""
    half = half_vector(frame, light)
    inverse_d = inverse_ggx_d(half, a2, disc)
    inverse_g2 = inverse_smith_g2(half.cos_i, frame.cos_o, a2, view_term)
    return microfacet_lobe(half, a2, inverse_d, inverse_g2), half.length2


@inlined
def _broad(frame, view2, a2, view_term, light, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """As `_narrow`, for lobes that `is_broad` accepts; takes three quarters of the time."""
    half = half_vector_broad(frame, view2, light)
    inverse_d = inverse_ggx_d_first_order(half, a2, disc)
    inverse_g2 = inverse_smith_g2(half.cos_i, frame.cos_o, a2, view_term)
    return microfacet_lobe(half, a2, inverse_d, inverse_g2), half.length2


@kernel
def is_broad(stored_frame, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Whether the specular lobes bear `_broad`, with discs of at most that squared radius.

    Rounding of q, 4e-7, is below 1e-4 of |q_t|^2 + a^2 s^2 at the peak, where s = 2 n.v; the second order in the disc,
    at most 0.75 (disc / a^2)^2, is below 0.2 %.
    """
    frame = load_frame(stored_frame)
    a2 = frame.alpha * frame.alpha
    return a2 * frame.cos_o * frame.cos_o > np.float32(1e-3) and disc <= np.float32(0.05) * a2


def _dielectric_lobe(lobe):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Compiles the sum of the dielectric lobe with `_narrow` or `_broad`."""

    @kernel
    def add(stored_frame, widen, rows, first, last, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        frame = load_frame(stored_frame)
        view2, a2 = _twice_view(frame), frame.alpha * frame.alpha
        view_term = smith_view_term(frame.cos_o, a2)
        red = green = blue = white = _ZERO
        for t in range(first, last):
            value, q = lobe(frame, view2, a2, view_term, _direction(rows, t), widen * rows[SPREAD, t])
            weight = value * fresnel_dielectric(q)
            red += weight * rows[RED, t]
            green += weight * rows[GREEN, t]
            blue += weight * rows[BLUE, t]
            white += weight * rows[SOLID_ANGLE, t]
        sums[3] += red
        sums[4] += green
        sums[5] += blue
        sums[17] += white

    return add


def _metal_lobe(lobe):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Compiles the sum of both parts of the metallic lobe with `_narrow` or `_broad`."""

    @kernel
    def add(stored_frame, widen, rows, first, last, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        frame = load_frame(stored_frame)
        view2, a2 = _twice_view(frame), frame.alpha * frame.alpha
        view_term = smith_view_term(frame.cos_o, a2)
        red0 = green0 = blue0 = white0 = red90 = green90 = blue90 = white90 = _ZERO
        for t in range(first, last):
            value, q = lobe(frame, view2, a2, view_term, _direction(rows, t), widen * rows[SPREAD, t])
            f90 = value * fresnel_schlick_weight(q)
            f0 = value - f90
            red0 += f0 * rows[RED, t]
            green0 += f0 * rows[GREEN, t]
            blue0 += f0 * rows[BLUE, t]
            white0 += f0 * rows[SOLID_ANGLE, t]
            red90 += f90 * rows[RED, t]
            green90 += f90 * rows[GREEN, t]
            blue90 += f90 * rows[BLUE, t]
            white90 += f90 * rows[SOLID_ANGLE, t]
        sums[6] += red0
        sums[7] += green0
        sums[8] += blue0
        sums[18] += white0
        sums[9] += red90
        sums[10] += green90
        sums[11] += blue90
        sums[19] += white90

    return add


_dielectric_narrow, _dielectric_broad = (_dielectric_lobe(lobe) for lobe in (_narrow, _broad))  # type: ignore[no-untyped-call]
_metal_narrow, _metal_broad = (_metal_lobe(lobe) for lobe in (_narrow, _broad))  # type: ignore[no-untyped-call]


def _both_lobes(lobe):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Compiles the sum of both specular lobes, which share all but Fresnel, with `_narrow` or `_broad`."""

    @kernel
    def add(stored_frame, widen, rows, first, last, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        frame = load_frame(stored_frame)
        view2, a2 = _twice_view(frame), frame.alpha * frame.alpha
        view_term = smith_view_term(frame.cos_o, a2)
        all_r = all_g = all_b = all_w = _ZERO
        coat_r = coat_g = coat_b = coat_w = _ZERO
        edge_r = edge_g = edge_b = edge_w = _ZERO
        for t in range(first, last):
            value, q = lobe(frame, view2, a2, view_term, _direction(rows, t), widen * rows[SPREAD, t])
            coat, edge = value * fresnel_dielectric(q), value * fresnel_schlick_weight(q)
            r, g, b, w = rows[RED, t], rows[GREEN, t], rows[BLUE, t], rows[SOLID_ANGLE, t]
            all_r, all_g, all_b, all_w = all_r + value * r, all_g + value * g, all_b + value * b, all_w + value * w
            coat_r, coat_g, coat_b, coat_w = coat_r + coat * r, coat_g + coat * g, coat_b + coat * b, coat_w + coat * w
            edge_r, edge_g, edge_b, edge_w = edge_r + edge * r, edge_g + edge * g, edge_b + edge * b, edge_w + edge * w
        sums[3], sums[4], sums[5], sums[17] = sums[3] + coat_r, sums[4] + coat_g, sums[5] + coat_b, sums[17] + coat_w
        sums[6], sums[7] = sums[6] + all_r - edge_r, sums[7] + all_g - edge_g
        sums[8], sums[18] = sums[8] + all_b - edge_b, sums[18] + all_w - edge_w
        sums[9], sums[10], sums[11] = sums[9] + edge_r, sums[10] + edge_g, sums[11] + edge_b
        sums[19] += edge_w

    return add


add_both_narrow, add_both_broad = (_both_lobes(lobe) for lobe in (_narrow, _broad))  # type: ignore[no-untyped-call]
"""Add both specular lobes of texels [first, last) of rows [8, N] to lobe sums [20], times 2 pi: as `add_lobes`."""


@kernel
def add_lobes(stored_frame, widen, rows, first, last, lobes, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the sums of `lobes` over texels to `sums`; the specular ones times 2 pi (see `scale_lobes`).

    Args:
        stored_frame: [12] ShadingFrame.
        widen: squared radius of a texel's disc of half vectors over its angular variance.
        rows: [8, N] texels.
        first: texel to begin at, unsigned.
        last: texel to end before, unsigned.
        lobes: Lobes.
        sums: [20] float32.
    """
    if lobes.diffuse == LAMBERT:
        _add_lambert(stored_frame, rows, first, last, sums)
    elif lobes.diffuse == DISNEY:
        _add_disney(stored_frame, rows, first, last, sums)
    if lobes.broad:
        if lobes.dielectric:
            _dielectric_broad(stored_frame, widen, rows, first, last, sums)
        if lobes.metal:
            _metal_broad(stored_frame, widen, rows, first, last, sums)
        return
    if lobes.dielectric:
        _dielectric_narrow(stored_frame, widen, rows, first, last, sums)
    if lobes.metal:
        _metal_narrow(stored_frame, widen, rows, first, last, sums)


@kernel
def scale_lobes(sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Multiplies the specular sums by the 1 / (2 pi) that `add_lobes` leaves out."""
    for k in range(3, 12):
        sums[k] *= _INV_2PI
    for k in range(13, 16):
        sums[k] *= _INV_2PI
    for k in range(17, 20):
        sums[k] *= _INV_2PI
