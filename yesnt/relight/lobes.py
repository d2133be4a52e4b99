"""The four lobes of one pixel summed over rows of texels, eight or more to a vector.

In a pixel's frame (n, t, b) with the view in the n-t plane and s = n.l + n.v, the unnormalised half vector l + v has
tangent part q_t = (t.l + t.v, b.l) and squared length q = |q_t|^2 + s^2, so that
    D = a2 q^2 / (pi (|q_t|^2 + a2 s^2)^2)   and   v.h = sqrt(q) / 2:
sums of squares only, which keeps float32 exact at the peak of a sharp lobe where 1 - (n.h)^2 would cancel.

A texel is a disc, not a point. In slopes m = q_t / s GGX is a2 / (pi (m^2 + a2)^2): the stereographic image of the
uniform sphere, which maps discs to caps. So the mean of D over a disc of squared radius d is exact:
    with x = m^2 + a2 - d and r = sqrt(x^2 + 4 a2 d):  2 a2 / (pi r (r + x)),
and no lobe, however sharp, falls between texels, nor does its tail grow as texels do.

Rows of texels are x, y, z, red, green, blue, solid angle and spread (`Texels.rows`), counted from 0 by unsigned
numbers: of an index that might be negative LLVM makes gathers.
"""

from __future__ import annotations

import math

import numpy as np

from yesnt.relight.brdf import COS_MIN
from yesnt.relight.compiled import inlined, kernel

FRESNEL = tuple(np.float32(c) for c in (0.03995, 0.08202, 0.43506, 0.39882, 0.04397))
"""The exact Fresnel of IOR 1.5 within 2e-4: 1 and the powers 2, 4, 8 and 16 of 1 - v.h, by as many squarings."""

_C0, _C2, _C4, _C8, _C16 = FRESNEL
NO_DIFFUSE, LAMBERT, DISNEY = 0, 1, 2
"""What `add_lobes` adds to the diffuse column."""

_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)
_INV_2PI = np.float32(0.5 / math.pi)


@kernel
def set_frame(nx, ny, nz, vx, vy, vz, frame):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Normal, tangent, bitangent, n.v and t.v; a view behind the normal is bent to just above the horizon."""
    cosine = nx * vx + ny * vy + nz * vz
    tx, ty, tz = vx - cosine * nx, vy - cosine * ny, vz - cosine * nz
    length = math.sqrt(tx * tx + ty * ty + tz * tz)
    if length < np.float32(1e-6):  # looking along the normal: any tangent will do
        if abs(nx) < np.float32(0.7):
            tx, ty, tz = _ONE - nx * nx, -nx * ny, -nx * nz
        else:
            tx, ty, tz = -ny * nx, _ONE - ny * ny, -ny * nz
        length = math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / length, ty / length, tz / length
    nv = min(max(cosine, np.float32(COS_MIN)), _ONE)
    frame[0], frame[1], frame[2] = nx, ny, nz
    frame[3], frame[4], frame[5] = tx, ty, tz
    frame[6], frame[7], frame[8] = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    frame[9], frame[10] = nv, math.sqrt(max(_ONE - nv * nv, _ZERO))


@kernel
def _cosine_sum(frame, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    nx, ny, nz = frame[0], frame[1], frame[2]
    s0 = s1 = s2 = sw = _ZERO
    for t in range(np.uintp(first), np.uintp(last)):
        nl = max(nx * rows[0, t] + ny * rows[1, t] + nz * rows[2, t], _ZERO)
        s0 += nl * rows[3, t]
        s1 += nl * rows[4, t]
        s2 += nl * rows[5, t]
        sw += nl * rows[6, t]
    out[0] += s0
    out[1] += s1
    out[2] += s2
    out[16] += sw


@kernel
def _disney_sum(frame, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The cosine sum weighted as Burley's diffuse is; brdf.disney_diffuse, with cos_d^2 = |l + v|^2 / 4."""
    frame = _fixed(frame)
    half_rough, out_weight = _HALF * math.sqrt(frame[11]), (_ONE - frame[9]) ** 5
    s0 = s1 = s2 = sw = _ZERO
    for t in range(np.uintp(first), np.uintp(last)):
        nl = max(frame[0] * rows[0, t] + frame[1] * rows[1, t] + frame[2] * rows[2, t], _ZERO)
        along = frame[3] * rows[0, t] + frame[4] * rows[1, t] + frame[5] * rows[2, t] + frame[10]
        across = frame[6] * rows[0, t] + frame[7] * rows[1, t] + frame[8] * rows[2, t]
        s, under = nl + frame[9], max(_ONE - nl, _ZERO)
        grazing = half_rough * (along * along + across * across + s * s) - _HALF
        in_weight = (under * under) * (under * under) * under
        w = nl * (_ONE + grazing * in_weight) * (_ONE + grazing * out_weight)
        s0 += w * rows[3, t]
        s1 += w * rows[4, t]
        s2 += w * rows[5, t]
        sw += w * rows[6, t]
    out[0] += s0
    out[1] += s1
    out[2] += s2
    out[16] += sw


@inlined
def _fixed(frame):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The frame as numbers, which stay in registers."""
    return (
        frame[0], frame[1], frame[2], frame[3], frame[4], frame[5],
        frame[6], frame[7], frame[8], frame[9], frame[10], frame[11],
    )  # fmt: skip


@inlined
def _view(frame):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Twice the view of a frame, bent above the horizon as n.v is."""
    nv, tv = _TWO * frame[9], _TWO * frame[10]
    return nv * frame[0] + tv * frame[3], nv * frame[1] + tv * frame[4], nv * frame[2] + tv * frame[5]


@inlined
def _smith(frame, a2, nl, smith_o):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    return frame[9] * (math.sqrt(nl * nl * (_ONE - a2) + a2) + nl * smith_o)


@inlined
def _narrow(frame, view, a2, smith_o, lx, ly, lz, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """2 pi D V n.l of one texel, and q = |l + v|^2; see the head of this file."""
    nl = max(frame[0] * lx + frame[1] * ly + frame[2] * lz, _ZERO)
    along = frame[3] * lx + frame[4] * ly + frame[5] * lz + frame[10]
    across = frame[6] * lx + frame[7] * ly + frame[8] * lz
    s = nl + frame[9]
    tangent = along * along + across * across
    s2 = s * s
    q = tangent + s2
    x = tangent + (a2 - disc) * s2
    half = _TWO * a2 * disc * (s2 * s2)
    root = math.sqrt(x * x + _TWO * half)
    square = max(root * (root + x), half)  # a bound of it that does not cancel where x is near -r
    return nl * a2 * q * q / (_HALF * square * _smith(frame, a2, nl, smith_o)), q


@inlined
def _broad(frame, view, a2, smith_o, lx, ly, lz, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """As `_narrow` where `is_broad` says so: q = 2 + 2 v.l, |q_t|^2 = q - s^2, the mean to first order."""
    nl = max(frame[0] * lx + frame[1] * ly + frame[2] * lz, _ZERO)
    s = nl + frame[9]
    s2 = s * s
    q = max(view[0] * lx + view[1] * ly + view[2] * lz + _TWO, s2)  # opposite to the view it may round to below 0
    tangent, wide = q - s2, a2 * s2
    y = tangent + wide
    square = y * y + disc * s2 * (wide - _TWO * tangent)
    return nl * a2 * q * q / (square * _smith(frame, a2, nl, smith_o)), q


@kernel
def is_broad(frame, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Whether a lobe bears `_broad` with discs of at most that squared radius.

    Rounding of q, 4e-7, is below 1e-4 of |q_t|^2 + a2 s^2 at the peak, where s = 2 n.v; the second order in d, at most
    0.75 (d / a2)^2, is below 0.2 %.
    """
    a2 = frame[11] * frame[11]
    return a2 * frame[9] * frame[9] > np.float32(1e-3) and disc <= np.float32(0.05) * a2


def _dielectric_lobe(shape_of):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The dielectric lobe over texels, with one of the shapes."""

    @kernel
    def lobe(frame, widen, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        fixed, view, a2 = _fixed(frame), _view(frame), frame[11] * frame[11]
        smith_o = math.sqrt(frame[9] * frame[9] * (_ONE - a2) + a2) / frame[9]
        s0 = s1 = s2 = sw = _ZERO
        for t in range(np.uintp(first), np.uintp(last)):
            shape, q = shape_of(fixed, view, a2, smith_o, rows[0, t], rows[1, t], rows[2, t], widen * rows[7, t])
            m = _ONE - _HALF * math.sqrt(q)
            m2 = m * m
            m4 = m2 * m2
            m8 = m4 * m4
            w = shape * (_C0 + _C2 * m2 + _C4 * m4 + m8 * (_C8 + _C16 * m8))
            s0 += w * rows[3, t]
            s1 += w * rows[4, t]
            s2 += w * rows[5, t]
            sw += w * rows[6, t]
        out[3] += s0
        out[4] += s1
        out[5] += s2
        out[17] += sw

    return lobe


def _metal_lobe(shape_of):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The two parts of the metallic lobe over texels, with one of the shapes."""

    @kernel
    def lobe(frame, widen, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        fixed, view, a2 = _fixed(frame), _view(frame), frame[11] * frame[11]
        smith_o = math.sqrt(frame[9] * frame[9] * (_ONE - a2) + a2) / frame[9]
        s0 = s1 = s2 = sw = f0 = f1 = f2 = fw = _ZERO
        for t in range(np.uintp(first), np.uintp(last)):
            shape, q = shape_of(fixed, view, a2, smith_o, rows[0, t], rows[1, t], rows[2, t], widen * rows[7, t])
            m = max(_ONE - _HALF * math.sqrt(q), _ZERO)
            high = shape * (m * m) * (m * m) * m
            low = shape - high
            s0 += low * rows[3, t]
            s1 += low * rows[4, t]
            s2 += low * rows[5, t]
            sw += low * rows[6, t]
            f0 += high * rows[3, t]
            f1 += high * rows[4, t]
            f2 += high * rows[5, t]
            fw += high * rows[6, t]
        out[6] += s0
        out[7] += s1
        out[8] += s2
        out[18] += sw
        out[9] += f0
        out[10] += f1
        out[11] += f2
        out[19] += fw

    return lobe


_dielectric_narrow, _dielectric_broad = (_dielectric_lobe(shape) for shape in (_narrow, _broad))  # type: ignore[no-untyped-call]
_metal_narrow, _metal_broad = (_metal_lobe(shape) for shape in (_narrow, _broad))  # type: ignore[no-untyped-call]


@kernel
def add_lobes(frame, widen, rows, first, last, wanted, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the wanted of (diffuse, dielectric, metal; broad) over texels [first, last) of rows [8, N] to out [20]."""
    if wanted[0] == LAMBERT:
        _cosine_sum(frame, rows, first, last, out)
    elif wanted[0] == DISNEY:
        _disney_sum(frame, rows, first, last, out)
    if wanted[3]:
        if wanted[1]:
            _dielectric_broad(frame, widen, rows, first, last, out)
        if wanted[2]:
            _metal_broad(frame, widen, rows, first, last, out)
        return
    if wanted[1]:
        _dielectric_narrow(frame, widen, rows, first, last, out)
    if wanted[2]:
        _metal_narrow(frame, widen, rows, first, last, out)


@kernel
def scale_lobes(out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """1 / (2 pi), left out of the lobes' loops."""
    for k in range(3, 12):
        out[k] *= _INV_2PI
    for k in range(13, 16):
        out[k] *= _INV_2PI
    for k in range(17, 20):
        out[k] *= _INV_2PI
