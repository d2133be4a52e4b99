"""The full sum over a light's texels, one pixel after another, texels in vector lanes.

In a pixel's frame (n, t, b) with the view in the n-t plane and s = n.l + n.v, the unnormalised half vector l + v has
tangent part q_t = (t.l + t.v, b.l) and squared length q = |q_t|^2 + s^2, so that
    D = a2 q^2 / (pi (|q_t|^2 + a2 s^2)^2)   and   v.h = sqrt(q) / 2:
sums of squares only, which keeps float32 exact at the peak of a sharp lobe where 1 - (n.h)^2 would cancel.

A texel is a disc, not a point. In slopes m = q_t / s GGX is a2 / (pi (m^2 + a2)^2): the stereographic image of the uniform
sphere, which maps discs to caps. So the mean of D over a disc of squared radius d is exact:
    with x = m^2 + a2 - d and r = sqrt(x^2 + 4 a2 d):  2 a2 / (pi r (r + x)),
and a lobe of any sharpness falls between no texels, nor does its tail grow when texels do.

A pixel first chooses what it sums: nothing of clusters below its horizon, one direction for clusters that are hidden (they
glow with what bounces), and texels of a size that its lobe can bear of all others. These are copied into a short scratch
that stays in the cache, whose loops have no branch. Irradiance needs no texels but at the horizon: above it the clamped
cosine is linear, and a cluster's first moment is exact.

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
from yesnt.relight.lights import Clusters, PreparedLight

F32 = NDArray[np.float32]

_GROUP = 32  # pixels that share a scratch allocation
_SCRATCH = 1024  # texels gathered at a time: 32 kB
_STRIDE = 1040  # floats from row to row of the scratch: rows a power of two apart share a cache set
_LONG = 16  # blocks that are worth a loop of their own: it costs as much to start as it does to gather so many
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
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)
_INV_2PI = np.float32(0.5 / math.pi)
_RED, _GREEN, _BLUE = (np.float32(w) for w in LUMINANCE_REC709)

IRRADIANCE, DIELECTRIC, METAL_F0, METAL_F90 = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Columns of `sum_lobes`' result: R, G, B each."""

LIT = slice(0, 12)
"""All of them."""

OPEN_LIGHT = slice(12, 16)
"""The same four sums for luminance with nothing occluded."""

WHITE = slice(16, 20)
"""The same four sums for radiance 1 from everywhere: what the texels make of an albedo that is known exactly."""

COLUMNS = 20

WIDEN = 0.5
"""Squared radius of a texel's disc of half vectors over its angular variance, times n.v: half the area is d^2 / 2 of a disc, and
half vectors fill 1 / (4 v.h) of the solid angle of the light (Walter 2007, eq. 14)."""

LEAST_COSINE = 0.3
"""n.v below which a lobe is taken to grow no narrower across the plane of incidence: it grows longer along it."""


@dataclass(frozen=True)
class ShadingPoints:
    """Pixels as structure of arrays.

    Attributes:
        normal: [3, P] unit, world.
        view: [3, P] unit, world, towards the camera.
        alpha: [P] alpha_ggx.
        dielectric: [P] uint8, 1 where the dielectric lobe is wanted.
        metal: [P] uint8, 1 where the metallic (Schlick) lobe is wanted.
    """

    normal: F32
    view: F32
    alpha: F32
    dielectric: NDArray[np.uint8]
    metal: NDArray[np.uint8]


def sum_lobes(
    points: ShadingPoints,
    light: PreparedLight,
    hidden: NDArray[np.bool_] | None,
    bounce: F32 | None,
    filtered: bool = True,
) -> F32:
    """Integrates the light's texels over the lobes of every pixel.

    Args:
        points: the pixels.
        light: the texels.
        hidden: [P, C] which light clusters something stands before; None: nothing.
        bounce: [3, P, C] radiance that comes from a hidden cluster's direction instead of its light; None: 0.
        filtered: average each lobe over each texel, and take finer texels where a lobe is sharp; False: plain samples of
            level 0.

    Returns:
        [P, 20]: irradiance, dielectric, F0 and F90 parts of the metallic lobe (RGB each), then the four sums of the
        open luminance and of uniform white.
    """
    count = points.alpha.shape[0]
    out = np.zeros((count, COLUMNS), dtype=np.float32)
    if count:
        nothing = np.zeros((0, 0), dtype=np.bool_)
        glow = np.zeros((3, 0, 0), dtype=np.float32) if bounce is None else bounce
        texels = light.texels
        _sum_lobes(
            (points.normal, points.view, points.alpha, points.dielectric, points.metal),
            (texels.rows, texels.packed, texels.start, texels.size),
            (light.cone, light.moment, cluster_rows(light.clusters)),
            (nothing if hidden is None else hidden, glow),
            (np.float32(light.detail if filtered else np.inf), np.float32(WIDEN if filtered else 0.0)),
            out,
        )
    return out


def cluster_rows(clusters: Clusters) -> F32:
    """Clusters as texels: rows [8, C], as `Texels.rows`."""
    return np.concatenate([clusters.direction, clusters.energy, clusters.solid_angle[None], clusters.spread[None]])


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _sum_lobes(points, texels, clusters, blocked, sizes, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    count, parts = points[2].shape[0], clusters[0].shape[1]
    for group in prange((count + _GROUP - 1) // _GROUP):
        choice = (np.empty(parts, dtype=np.float32), np.empty(parts, dtype=np.int32), np.zeros(parts, dtype=np.uint8))
        runs, frame = np.empty((parts, 2), dtype=np.int32), np.empty(12, dtype=np.float32)
        packed, glow = np.empty((8, _STRIDE // 2), dtype=np.float64), clusters[2].copy()
        scratch = (packed, packed.view(np.float32), glow, np.empty(COLUMNS, dtype=np.float32))
        for p in range(group * _GROUP, min(count, (group + 1) * _GROUP)):
            _one_pixel(p, points, texels, clusters, blocked, sizes, scratch, choice, runs, frame, out[p])


@njit(cache=True, fastmath=True, error_model="numpy")
def _one_pixel(p, points, texels, clusters, blocked, sizes, scratch, choice, runs, frame, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    normal, view, alpha, dielectric, metal = points
    cone, start = clusters[0], texels[2]
    facing, level, behind = choice
    _frame(normal[0, p], normal[1, p], normal[2, p], view[0, p], view[1, p], view[2, p], frame)
    frame[11] = alpha[p]
    widen = sizes[1] / max(frame[9], np.float32(LEAST_COSINE))
    shut = _hide(blocked[0], p, behind)
    _choose(frame, sizes[0], texels[3], cone, facing, level)
    _above_the_horizon(cone, clusters[1], facing, behind, frame, out)
    used = _runs_at_the_horizon(start, cone, facing, behind, runs)
    _sum_runs(texels, runs, used, scratch, (True, False, False), frame, widen, out)
    used = _runs_in_sight(start, cone, facing, behind, level, runs)
    _sum_runs(texels, runs, used, scratch, (False, dielectric[p] != 0, metal[p] != 0), frame, widen, out)
    for k in range(4):  # so far nothing that is hidden
        out[12 + k] = _RED * out[3 * k] + _GREEN * out[3 * k + 1] + _BLUE * out[3 * k + 2]
    if shut:
        wanted = (True, dielectric[p] != 0, metal[p] != 0)
        _glow(p, clusters[2], behind, blocked[1], frame, widen, wanted, scratch[2], scratch[3], out)
    _scale(out)


@njit(cache=True, fastmath=True, error_model="numpy")
def _hide(hidden, p, behind):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which clusters pixel p does not see; how many."""
    shut = 0
    if hidden.shape[0] > 0:
        for c in range(behind.shape[0]):
            behind[c] = hidden[p, c]
            shut += behind[c]
    return shut


@njit(cache=True, fastmath=True, error_model="numpy")
def _choose(frame, detail, size, cone, facing, level):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes n.l of every cluster and the coarsest level whose texels are small beside the lobe there.

    A lobe about the mirror direction is 2 alpha wide, n.v times that across the plane of incidence, and its tail a distance
    d from there varies over d.
    """
    nv, tv, alpha = frame[9], frame[10], frame[11]
    mx, my, mz = nv * frame[0] - tv * frame[3], nv * frame[1] - tv * frame[4], nv * frame[2] - tv * frame[5]
    core = _TWO * alpha * max(nv, np.float32(LEAST_COSINE))
    for c in range(facing.shape[0]):
        x, y, z, sine = cone[0, c], cone[1, c], cone[2, c], cone[3, c]
        facing[c] = x * frame[0] + y * frame[1] + z * frame[2]
        away = math.sqrt(max(_TWO - _TWO * (x * mx + y * my + z * mz), _ZERO))
        bearable = detail * (core + max(away - sine, _ZERO))
        finer = 0
        for k in range(size.shape[0] - 1):
            finer += size[k, c] > bearable
        level[c] = finer


@njit(cache=True, fastmath=True, error_model="numpy")
def _runs_at_the_horizon(start, cone, facing, behind, runs):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes runs of level 0 blocks of clusters that the horizon cuts: how many."""
    used = 0
    for c in range(facing.shape[0]):
        if behind[c] == 0 and abs(facing[c]) <= cone[3, c]:
            used = _append(runs, used, start[0, c], start[0, c + 1])
    return used


@njit(cache=True, fastmath=True, error_model="numpy")
def _runs_in_sight(start, cone, facing, behind, level, runs):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes runs of blocks, at their levels, of clusters that are up and not hidden: how many."""
    used = 0
    for c in range(facing.shape[0]):
        if behind[c] == 0 and facing[c] > -cone[3, c]:
            used = _append(runs, used, start[level[c], c], start[level[c], c + 1])
    return used


@njit(cache=True, error_model="numpy", inline="always")
def _append(runs, used, first, last):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds a run or lengthens the last one: how many there are."""
    if used > 0 and runs[used - 1, 1] == first:
        runs[used - 1, 1] = last
        return used
    runs[used, 0], runs[used, 1] = first, last
    return used + 1


@njit(cache=True, fastmath=True, error_model="numpy")
def _sum_runs(texels, runs, used, scratch, wanted, frame, widen, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Sums runs of blocks: long ones where they lie, short ones gathered in the scratch."""
    rows, source, target, gathered = texels[0], texels[1], scratch[0], scratch[1]
    full = 0
    for i in range(used):
        first, last = runs[i, 0], runs[i, 1]
        if last - first >= _LONG:
            _add(frame, widen, rows, 8 * first, 8 * last, wanted, out)
            continue
        if full + last - first > _SCRATCH // 8:
            _add(frame, widen, gathered, 0, 8 * full, wanted, out)
            full = 0
        for b in range(first, last):
            at, on = 4 * b, 4 * full
            for k in range(8):
                one, two, three, four = source[k, at], source[k, at + 1], source[k, at + 2], source[k, at + 3]
                target[k, on], target[k, on + 1], target[k, on + 2], target[k, on + 3] = one, two, three, four
            full += 1
    _add(frame, widen, gathered, 0, 8 * full, wanted, out)


@njit(cache=True, fastmath=True, error_model="numpy")
def _add(frame, widen, rows, first, last, wanted, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if wanted[0]:
        _cosine_sum(frame, rows, first, last, out)
    if wanted[1]:
        _dielectric_lobe(frame, widen, rows, first, last, out)
    if wanted[2]:
        _metal_lobe(frame, widen, rows, first, last, out)


@njit(cache=True, fastmath=True, error_model="numpy")
def _above_the_horizon(cone, moment, facing, behind, frame, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds the irradiance, and that of white, of clusters wholly above the horizon."""
    r0 = r1 = r2 = g0 = g1 = g2 = b0 = b1 = b2 = w0 = w1 = w2 = _ZERO
    for c in range(facing.shape[0]):
        on = _ONE if behind[c] == 0 and facing[c] > cone[3, c] else _ZERO
        r0 += on * moment[0, c]
        r1 += on * moment[1, c]
        r2 += on * moment[2, c]
        g0 += on * moment[3, c]
        g1 += on * moment[4, c]
        g2 += on * moment[5, c]
        b0 += on * moment[6, c]
        b1 += on * moment[7, c]
        b2 += on * moment[8, c]
        w0 += on * moment[9, c]
        w1 += on * moment[10, c]
        w2 += on * moment[11, c]
    nx, ny, nz = frame[0], frame[1], frame[2]
    out[0] += r0 * nx + r1 * ny + r2 * nz
    out[1] += g0 * nx + g1 * ny + g2 * nz
    out[2] += b0 * nx + b1 * ny + b2 * nz
    out[16] += w0 * nx + w1 * ny + w2 * nz


@njit(cache=True, fastmath=True, error_model="numpy")
def _cosine_sum(frame, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    nx, ny, nz = frame[0], frame[1], frame[2]
    s0 = s1 = s2 = sw = _ZERO
    for t in range(first, last):
        nl = max(nx * rows[0, t] + ny * rows[1, t] + nz * rows[2, t], _ZERO)
        s0 += nl * rows[3, t]
        s1 += nl * rows[4, t]
        s2 += nl * rows[5, t]
        sw += nl * rows[6, t]
    out[0] += s0
    out[1] += s1
    out[2] += s2
    out[16] += sw


@njit(cache=True, fastmath=True, error_model="numpy")
def _glow(p, whole, behind, bounce, frame, widen, wanted, rows, open_, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds what hidden clusters glow with, one direction each, and what would come from there in the open."""
    count = behind.shape[0]
    for c in range(count):
        rows[6, c] = behind[c] * whole[6, c]
        rows[3, c] = behind[c] * (_RED * whole[3, c] + _GREEN * whole[4, c] + _BLUE * whole[5, c])
    open_[:] = _ZERO
    _add(frame, widen, rows, 0, count, wanted, open_)
    for k in range(3):
        if bounce.shape[1] > 0:
            for c in range(count):
                rows[3 + k, c] = rows[6, c] * bounce[k, p, c]
        else:
            rows[3 + k, :] = _ZERO
    _add(frame, widen, rows, 0, count, wanted, out)
    for k in range(4):
        out[12 + k] += open_[3 * k]


@njit(cache=True, fastmath=True, error_model="numpy")
def _scale(out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """1 / (2 pi), left out of the lobes' loops."""
    for k in range(3, 12):
        out[k] *= _INV_2PI
    for k in range(13, 16):
        out[k] *= _INV_2PI
    for k in range(17, 20):
        out[k] *= _INV_2PI


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


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _shape(frame, a2, smith_o, lx, ly, lz, disc):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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
    smith = frame[9] * (math.sqrt(nl * nl * (_ONE - a2) + a2) + nl * smith_o)
    return nl * a2 * q * q / (_HALF * square * smith), q


@njit(cache=True, fastmath=True, error_model="numpy")
def _dielectric_lobe(frame, widen, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    fixed = (
        frame[0],
        frame[1],
        frame[2],
        frame[3],
        frame[4],
        frame[5],
        frame[6],
        frame[7],
        frame[8],
        frame[9],
        frame[10],
    )
    a2 = frame[11] * frame[11]
    smith_o = math.sqrt(frame[9] * frame[9] * (_ONE - a2) + a2) / frame[9]
    s0 = s1 = s2 = sw = _ZERO
    for t in range(first, last):
        shape, q = _shape(fixed, a2, smith_o, rows[0, t], rows[1, t], rows[2, t], widen * rows[7, t])
        c = _HALF * math.sqrt(q)
        w = shape * (_C0 + c * (_C1 + c * (_C2 + c * (_C3 + c * (_C4 + c * (_C5 + c * (_C6 + c * _C7)))))))
        s0 += w * rows[3, t]
        s1 += w * rows[4, t]
        s2 += w * rows[5, t]
        sw += w * rows[6, t]
    out[3] += s0
    out[4] += s1
    out[5] += s2
    out[17] += sw


@njit(cache=True, fastmath=True, error_model="numpy")
def _metal_lobe(frame, widen, rows, first, last, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    fixed = (
        frame[0],
        frame[1],
        frame[2],
        frame[3],
        frame[4],
        frame[5],
        frame[6],
        frame[7],
        frame[8],
        frame[9],
        frame[10],
    )
    a2 = frame[11] * frame[11]
    smith_o = math.sqrt(frame[9] * frame[9] * (_ONE - a2) + a2) / frame[9]
    s0 = s1 = s2 = sw = f0 = f1 = f2 = fw = _ZERO
    for t in range(first, last):
        shape, q = _shape(fixed, a2, smith_o, rows[0, t], rows[1, t], rows[2, t], widen * rows[7, t])
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
