"""The full sum over a light's texels, one pixel after another, texels in vector lanes.

In a pixel's frame (n, t, b) with the view in the n-t plane and s = n.l + n.v, the unnormalised half vector l + v has
tangent part q_t = (t.l + t.v, b.l) and squared length q = |q_t|^2 + s^2, so that
    D = a2 q^2 / (pi (|q_t|^2 + a2 s^2)^2)   and   v.h = sqrt(q) / 2:
sums of squares only, which keeps float32 exact at the peak of a sharp lobe where 1 - (n.h)^2 would cancel.

Every lobe is linear in what later multiplies it, so one pass serves both relighting and the removal of capture light.
Results do not depend on the number of threads: a pixel is summed by one thread in one order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from yesnt.color import LUMINANCE_REC709
from yesnt.relight.brdf import COS_MIN, dielectric_fresnel
from yesnt.relight.lights import BLOCK, PreparedLight

F32 = NDArray[np.float32]

_GROUP = 32  # pixels that share a scratch allocation
_COS_NODES = np.linspace(0.0, 1.0, 2001)
FRESNEL = (
    np.polynomial.Polynomial.fit(_COS_NODES, dielectric_fresnel(_COS_NODES), 7)
    .convert()
    .coef.round(4)
    .astype(np.float32)
)
_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7 = (np.float32(c) for c in FRESNEL)  # within 1e-3 of the exact Fresnel
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_INV_2PI = np.float32(0.5 / math.pi)

IRRADIANCE, DIELECTRIC, METAL_F0, METAL_F90 = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Columns of `sum_lobes`' result: R, G, B each."""

OPEN_LIGHT = slice(12, 16)
"""The same four sums for luminance with nothing occluded."""

WHITE = slice(16, 20)
"""The same four sums for radiance 1 from everywhere: what the texels make of an albedo that is known exactly."""

COLUMNS = 20

SHARP = 0.1
"""alpha_ggx that 2,048 texels still resolve to 40 dB of the full sum (docs/relight.md)."""


@dataclass(frozen=True)
class ShadingPoints:
    """Pixels as structure of arrays.

    Attributes:
        normal: [3, P] unit, world.
        view: [3, P] unit, world, towards the camera.
        alpha: [P] alpha_ggx; each texel widens the lobe by its own angular size, so that none falls between texels.
        dielectric: [P] uint8, 1 where the dielectric lobe is wanted.
        metal: [P] uint8, 1 where the metallic (Schlick) lobe is wanted.
    """

    normal: F32
    view: F32
    alpha: F32
    dielectric: NDArray[np.uint8]
    metal: NDArray[np.uint8]


def sum_lobes(
    points: ShadingPoints, light: PreparedLight, visible: F32 | None, bounce: F32 | None, filtered: bool = True
) -> F32:
    """Integrates the light's texels over the lobes of every pixel.

    Args:
        points: the pixels.
        light: the texels.
        visible: [P, C] visibility of each light cluster in [0, 1]; None: all 1.
        bounce: [3, P, C] radiance that comes from the cluster's direction instead of its light; None: 0.

        filtered: widen each lobe by each texel's own size, so that none falls between texels; False: plain samples.

    Returns:
        [P, 20]: irradiance, dielectric, F0 and F90 parts of the metallic lobe (RGB each), then the four sums of the
        open luminance and of uniform white.
    """
    count = points.alpha.shape[0]
    out = np.zeros((count, COLUMNS), dtype=np.float32)
    if count:
        empty = np.zeros((0, 0), dtype=np.float32)
        glow = np.zeros((3, 0, 0), dtype=np.float32) if bounce is None else bounce
        weights = np.asarray(LUMINANCE_REC709, dtype=np.float32)
        widen = light.spread if filtered else np.zeros_like(light.spread)
        _sum_lobes(
            (points.normal, points.view, points.alpha, points.dielectric, points.metal),
            (light.direction, light.energy, weights @ light.energy, light.solid_angle, light.cluster_of, widen),
            (light.cone, light.cluster_cone, light.coarse_start, light.fine_start, sharp_below(light, filtered)),
            empty if visible is None else visible,
            glow,
            out,
        )
    return out


def sharp_below(light: PreparedLight, filtered: bool) -> np.float32:
    """alpha_ggx below which a lobe takes the fine cells: it shrinks as the texels do."""
    texels = int(light.coarse_start[-1])
    fine = filtered and light.direction.shape[1] > texels
    return np.float32(SHARP * math.sqrt(2048 / texels) if fine else 0.0)


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _sum_lobes(points, light, cuts, visible, bounce, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    normal, view, alpha, dielectric, metal = points
    count = alpha.shape[0]
    for group in prange((count + _GROUP - 1) // _GROUP):
        lit = np.empty(light[1].shape, dtype=np.float32)
        ranges = np.empty((max(cuts[0].shape[1], cuts[1].shape[1]), 2), dtype=np.int32)
        occluded = (visible, bounce, lit)
        frame = np.empty(11, dtype=np.float32)
        for p in range(group * _GROUP, min(count, (group + 1) * _GROUP)):
            _frame(normal[0, p], normal[1, p], normal[2, p], view[0, p], view[1, p], view[2, p], frame)
            used = _sharp_ranges(frame, alpha[p], cuts, ranges) if alpha[p] < cuts[4] else _ranges(frame, cuts, ranges)
            if dielectric[p]:
                _dielectric_lobe(p, frame, alpha[p], light, ranges[:used], occluded, out[p])
            if metal[p]:
                _metal_lobe(p, frame, alpha[p], light, ranges[:used], occluded, out[p])


@njit(cache=True, fastmath=True, error_model="numpy")
def _ranges(frame, cuts, ranges):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Ranges of texels that are not wholly below the horizon: how many were written."""
    cone, texels = cuts[0], cuts[2][-1]
    used = 0
    for block in range(cone.shape[1]):
        if cone[0, block] * frame[0] + cone[1, block] * frame[1] + cone[2, block] * frame[2] > -cone[3, block]:
            ranges[used, 0], ranges[used, 1] = block * BLOCK, min((block + 1) * BLOCK, texels)
            used += 1
    return used


@njit(cache=True, fastmath=True, error_model="numpy")
def _sharp_ranges(frame, alpha, cuts, ranges):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """As `_ranges`, but one a cluster, with the cells of the fine grid where the cluster meets the lobe's core."""
    cone, coarse, fine = cuts[1], cuts[2], cuts[3]
    margin = min(np.float32(0.08) + np.float32(3.0) * alpha, np.float32(1.5))
    cos_m, sin_m = math.cos(margin), math.sin(margin)
    nv, tv = frame[9], frame[10]
    mx, my, mz = nv * frame[0] - tv * frame[3], nv * frame[1] - tv * frame[4], nv * frame[2] - tv * frame[5]
    used = 0
    for c in range(cone.shape[1]):
        x, y, z, reach = cone[0, c], cone[1, c], cone[2, c], cone[3, c]
        if x * frame[0] + y * frame[1] + z * frame[2] <= -reach:
            continue
        near = reach > _ONE
        if not near:
            near = x * mx + y * my + z * mz > cos_m * math.sqrt(max(_ONE - reach * reach, _ZERO)) - sin_m * reach
        ranges[used, 0] = fine[c] if near else coarse[c]
        ranges[used, 1] = fine[c + 1] if near else coarse[c + 1]
        used += 1
    return used


@njit(cache=True, fastmath=True, error_model="numpy")
def _occlude(p, first, last, light, occluded):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes into `lit` what reaches pixel p from texels [first, last); False where that is the open light itself."""
    visible, bounce, lit = occluded
    if visible.shape[0] == 0:
        return False
    energy, solid, owner = light[1], light[3], light[4]
    row = visible[p]
    least = _ONE
    for c in range(owner[first], owner[last - 1] + 1):
        least = min(least, row[c])
    if least == _ONE:
        return False
    e0, e1, e2 = energy[0], energy[1], energy[2]
    l0, l1, l2 = lit[0], lit[1], lit[2]
    if bounce.shape[1] > 0:
        b0, b1, b2 = bounce[0, p], bounce[1, p], bounce[2, p]
        for t in range(first, last):
            c = owner[t]
            share, glow = row[c], solid[t]
            l0[t] = share * e0[t] + glow * b0[c]
            l1[t] = share * e1[t] + glow * b1[c]
            l2[t] = share * e2[t] + glow * b2[c]
    else:
        for t in range(first, last):
            share = row[owner[t]]
            l0[t] = share * e0[t]
            l1[t] = share * e1[t]
            l2[t] = share * e2[t]
    return True


@njit(cache=True, fastmath=True, error_model="numpy")
def _frame(nx, ny, nz, vx, vy, vz, frame):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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


@njit(cache=True, fastmath=True, error_model="numpy")
def _dielectric_lobe(p, frame, alpha, light, ranges, occluded, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    direction, energy, luminance, solid = light[0], light[1], light[2], light[3]
    widen = light[5]
    nx, ny, nz, tx, ty, tz = frame[0], frame[1], frame[2], frame[3], frame[4], frame[5]
    bx, by, bz, nv, tv = frame[6], frame[7], frame[8], frame[9], frame[10]
    a2 = alpha * alpha
    rest = _ONE - a2
    smith_o = math.sqrt(nv * nv * rest + a2)
    e0 = e1 = e2 = s0 = s1 = s2 = eu = su = ew = sw = _ZERO
    dx, dy, dz = direction[0], direction[1], direction[2]
    for i in range(ranges.shape[0]):
        first, last = ranges[i, 0], ranges[i, 1]
        here = occluded[2] if _occlude(p, first, last, light, occluded) else energy
        r, g, b = here[0], here[1], here[2]
        for t in range(first, last):
            lx, ly, lz = dx[t], dy[t], dz[t]
            nl = max(nx * lx + ny * ly + nz * lz, _ZERO)
            qt = tx * lx + ty * ly + tz * lz + tv
            qb = bx * lx + by * ly + bz * lz
            s = nl + nv
            tangent = qt * qt + qb * qb
            q = tangent + s * s
            c = _HALF * math.sqrt(q)
            b2 = a2 + widen[t]
            width = tangent + b2 * s * s
            smith = nv * math.sqrt(nl * nl * rest + a2) + nl * smith_o
            f = _C0 + c * (_C1 + c * (_C2 + c * (_C3 + c * (_C4 + c * (_C5 + c * (_C6 + c * _C7))))))
            w = nl * f * b2 * q * q / (width * width * smith)
            e0 += nl * r[t]
            e1 += nl * g[t]
            e2 += nl * b[t]
            eu += nl * luminance[t]
            ew += nl * solid[t]
            s0 += w * r[t]
            s1 += w * g[t]
            s2 += w * b[t]
            su += w * luminance[t]
            sw += w * solid[t]
    scale = _INV_2PI
    out[0], out[1], out[2], out[12], out[16] = e0, e1, e2, eu, ew
    out[3], out[4], out[5], out[13], out[17] = scale * s0, scale * s1, scale * s2, scale * su, scale * sw


@njit(cache=True, fastmath=True, error_model="numpy")
def _metal_lobe(p, frame, alpha, light, ranges, occluded, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    direction, energy, luminance, solid = light[0], light[1], light[2], light[3]
    widen = light[5]
    nx, ny, nz, tx, ty, tz = frame[0], frame[1], frame[2], frame[3], frame[4], frame[5]
    bx, by, bz, nv, tv = frame[6], frame[7], frame[8], frame[9], frame[10]
    a2 = alpha * alpha
    rest = _ONE - a2
    smith_o = math.sqrt(nv * nv * rest + a2)
    e0 = e1 = e2 = s0 = s1 = s2 = f0 = f1 = f2 = eu = su = fu = ew = sw = fw = _ZERO
    dx, dy, dz = direction[0], direction[1], direction[2]
    for i in range(ranges.shape[0]):
        first, last = ranges[i, 0], ranges[i, 1]
        here = occluded[2] if _occlude(p, first, last, light, occluded) else energy
        r, g, b = here[0], here[1], here[2]
        for t in range(first, last):
            lx, ly, lz = dx[t], dy[t], dz[t]
            nl = max(nx * lx + ny * ly + nz * lz, _ZERO)
            qt = tx * lx + ty * ly + tz * lz + tv
            qb = bx * lx + by * ly + bz * lz
            s = nl + nv
            tangent = qt * qt + qb * qb
            q = tangent + s * s
            m = max(_ONE - _HALF * math.sqrt(q), _ZERO)
            b2 = a2 + widen[t]
            width = tangent + b2 * s * s
            smith = nv * math.sqrt(nl * nl * rest + a2) + nl * smith_o
            shape = nl * b2 * q * q / (width * width * smith)
            high = shape * (m * m) * (m * m) * m
            low = shape - high
            e0 += nl * r[t]
            e1 += nl * g[t]
            e2 += nl * b[t]
            eu += nl * luminance[t]
            ew += nl * solid[t]
            s0 += low * r[t]
            s1 += low * g[t]
            s2 += low * b[t]
            su += low * luminance[t]
            sw += low * solid[t]
            f0 += high * r[t]
            f1 += high * g[t]
            f2 += high * b[t]
            fu += high * luminance[t]
            fw += high * solid[t]
    scale = _INV_2PI
    out[0], out[1], out[2], out[12], out[16] = e0, e1, e2, eu, ew
    out[6], out[7], out[8], out[14], out[18] = scale * s0, scale * s1, scale * s2, scale * su, scale * sw
    out[9], out[10], out[11], out[15], out[19] = scale * f0, scale * f1, scale * f2, scale * fu, scale * fw
