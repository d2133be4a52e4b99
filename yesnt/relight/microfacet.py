"""Terms of the BRDF as the compiled kernels use them, in float32; relight/brdf.py is the float64 reference.

Notation: n normal, v direction to the viewer, l direction to the light, h = (l + v) / |l + v| half vector,
cos_i = n.l, cos_o = n.v, cos_d = v.h, a = alpha_ggx.

In a pixel's frame (n, t, b), with v in the plane of n and t, the unnormalised half vector l + v has the normal part
s = cos_i + cos_o and the tangent part q_t = (t.l + t.v, b.l). With q = |l + v|^2 = |q_t|^2 + s^2:
    cos_h = s / sqrt(q),   cos_d = sqrt(q) / 2,   D = a^2 q^2 / (pi (|q_t|^2 + a^2 s^2)^2).
These are sums of squares, which keep float32 exact at the peak of a sharp lobe, where 1 - cos_h^2 would cancel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from yesnt.relight.compiled import inlined
from yesnt.relight.shading_frame import dot

FRESNEL = tuple(np.float32(c) for c in (0.03995, 0.08202, 0.43506, 0.39882, 0.04397))
"""Coefficients of the powers 0, 2, 4, 8 and 16 of 1 - cos_d: the exact Fresnel reflectance of IOR 1.5 within 2e-4."""

_C0, _C2, _C4, _C8, _C16 = FRESNEL
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)


class HalfVector(NamedTuple):
    """l + v of one pixel and one light direction, in the pixel's frame.

    Attributes:
        cos_i: n.l, at least 0.
        tangent2: |q_t|^2, squared length of the tangent part.
        normal2: s^2, squared length of the normal part.
        length2: q = |l + v|^2.
    """

    cos_i: np.float32
    tangent2: np.float32
    normal2: np.float32
    length2: np.float32


@inlined
def half_vector(frame, light):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """HalfVector of a ShadingFrame and a light direction (Vector, unit): exact enough for lobes of any width."""
    cos_i = max(dot(frame.normal, light), _ZERO)
    along = dot(frame.tangent, light) + frame.sin_o
    across = dot(frame.bitangent, light)
    s = cos_i + frame.cos_o
    tangent2, normal2 = along * along + across * across, s * s
    return HalfVector(cos_i, tangent2, normal2, tangent2 + normal2)


@inlined
def half_vector_broad(frame, view2, light):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """As `half_vector`, from q = 2 + 2 v.l: for lobes that bear its rounding (`lobes.is_broad`).

    Args:
        frame: ShadingFrame.
        view2: Vector, 2 v.
        light: Vector, unit.
    """
    cos_i = max(dot(frame.normal, light), _ZERO)
    s = cos_i + frame.cos_o
    normal2 = s * s
    length2 = max(dot(view2, light) + _TWO, normal2)  # opposite to the view it may round to below 0
    return HalfVector(cos_i, length2 - normal2, normal2, length2)


@inlined
def microfacet_lobe(half, a2, inverse_d, inverse_g2):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """2 pi D G2 / (4 cos_i cos_o) cos_i of one light direction: Cook-Torrance's lobe without F, times cos_i.

    D and G2 come as reciprocals, so that one division serves both.

    Args:
        half: HalfVector.
        a2: alpha_ggx squared.
        inverse_d: of `inverse_ggx_d`.
        inverse_g2: of `inverse_smith_g2`.
    """
    return half.cos_i * a2 * half.length2 * half.length2 / (inverse_d * inverse_g2)


@inlined
def inverse_ggx_d(half, a2, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """a^2 q^2 / (pi D), with D of GGX (Walter 2007, eq. 33) averaged over a disc of half vectors.

    In slopes m = q_t / s GGX is a^2 / (pi (m^2 + a^2)^2). That is the stereographic image of the uniform sphere, which
    maps discs to caps, so the mean over a disc is exact: with x = m^2 + a^2 - disc and r = sqrt(x^2 + 4 a^2 disc) it is
    2 a^2 / (pi r (r + x)).

    Args:
        half: HalfVector.
        a2: alpha_ggx squared.
        disc: squared radius of the disc in slopes.
    """
    x = half.tangent2 + (a2 - disc) * half.normal2
    least = _TWO * a2 * disc * (half.normal2 * half.normal2)
    root = math.sqrt(x * x + _TWO * least)
    return _HALF * max(root * (root + x), least)  # `least` is a bound that does not cancel where x is near -r


@inlined
def inverse_ggx_d_first_order(half, a2, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """As `inverse_ggx_d`, to first order in `disc`: for broad lobes (`lobes.is_broad`)."""
    wide = a2 * half.normal2
    y = half.tangent2 + wide
    return y * y + disc * half.normal2 * (wide - _TWO * half.tangent2)


@inlined
def smith_view_term(cos_o, a2):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """sqrt(cos_o^2 (1 - a^2) + a^2) / cos_o: the part of Smith's G2 that does not depend on the light."""
    return math.sqrt(cos_o * cos_o * (_ONE - a2) + a2) / cos_o


@inlined
def inverse_smith_g2(cos_i, cos_o, a2, view_term):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """2 cos_i cos_o / G2, height-correlated masking and shadowing of Smith (Heitz 2014, eq. 99).

    Args:
        cos_i: n.l.
        cos_o: n.v.
        a2: alpha_ggx squared.
        view_term: of `smith_view_term`.
    """
    return cos_o * (math.sqrt(cos_i * cos_i * (_ONE - a2) + a2) + cos_i * view_term)


@inlined
def fresnel_dielectric(length2):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """F of a smooth dielectric of IOR 1.5 (Walter 2007, eq. 22) at q = |l + v|^2, as a polynomial in 1 - cos_d."""
    m = _ONE - _HALF * math.sqrt(length2)
    m2 = m * m
    m4 = m2 * m2
    m8 = m4 * m4
    return _C0 + _C2 * m2 + _C4 * m4 + m8 * (_C8 + _C16 * m8)


@inlined
def fresnel_schlick_weight(length2):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Weight w = (1 - cos_d)^5 of Schlick's F = F0 (1 - w) + w (Schlick 1994) at q = |l + v|^2."""
    m = max(_ONE - _HALF * math.sqrt(length2), _ZERO)
    return (m * m) * (m * m) * m


@inlined
def disney_diffuse(half, half_roughness, weight_o):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Returns pi f cos_i of Burley's diffuse with base colour 1 (Burley 2012, section 5.3); see brdf.disney_diffuse.

    Args:
        half: HalfVector; cos_d^2 = q / 4.
        half_roughness: half of Disney's roughness.
        weight_o: (1 - cos_o)^5.
    """
    below = max(_ONE - half.cos_i, _ZERO)
    grazing = half_roughness * half.length2 - _HALF
    weight_i = (below * below) * (below * below) * below
    return half.cos_i * (_ONE + grazing * weight_i) * (_ONE + grazing * weight_o)
