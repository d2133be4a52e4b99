"""The full sum over a light's texels: what each pixel sums. How a texel is summed is in lobes.py.

A pixel first chooses what it sums: nothing of clusters below its horizon, one direction for clusters that are hidden
(they glow with what bounces), and of all others texels of a size that its lobe can bear. Short runs of these are copied
into a scratch that stays in the cache, whose loops have no branch. Irradiance needs no texels: above the horizon the
clamped cosine is linear and a cluster's first moment exact, and one that the horizon cuts passes it as an even square
would (68 dB or more to the full sum; where every cell is a texel, those of such clusters are summed).

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
from yesnt.relight.compiled import inlined, kernel
from yesnt.relight.lights import Clusters, PreparedLight
from yesnt.relight.lobes import DISNEY, LAMBERT, NO_DIFFUSE, add_lobes, is_broad, scale_lobes, set_frame

F32 = NDArray[np.float32]

_GROUP = 32  # pixels that share a scratch allocation
_SCRATCH = 1024  # texels gathered at a time: 32 kB
_STRIDE = 1040  # floats from row to row of the scratch: rows a power of two apart share a cache set
_ANY_SIZE = 1e9  # a `detail` that level 0 always meets; infinity is not a number that fast arithmetic knows
_FEW = 4  # blocks of a cluster that are gathered: to start a loop where they lie costs as much
_1, _2, _3 = np.uintp(1), np.uintp(2), np.uintp(3)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)
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
"""Squared radius of a texel's disc of half vectors over its angular variance, times n.v: a disc's variance is half its
squared radius, and half vectors fill 1 / (4 v.h) of the solid angle of the light (Walter 2007, eq. 14)."""

TAIL = 0.08
"""Growth of the texels that a lobe bears, for each of its widths that they lie away from its core."""

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
        disney: the diffuse is Burley's instead of Lambert's.
    """

    normal: F32
    view: F32
    alpha: F32
    dielectric: NDArray[np.uint8]
    metal: NDArray[np.uint8]
    disney: bool = False


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
        filtered: average each lobe over each texel, and take finer texels where a lobe is sharp; False: plain samples
            of level 0.

    Returns:
        [P, 20]: irradiance (weighted as the diffuse wants it), dielectric, F0 and F90 parts of the metallic lobe (RGB
        each), then the four sums of the open luminance and of uniform white.
    """
    count = points.alpha.shape[0]
    out = np.zeros((count, COLUMNS), dtype=np.float32)
    if count:
        nothing = np.zeros((0, 0), dtype=np.bool_)
        glow = np.zeros((3, 0, 0), dtype=np.float32) if bounce is None else bounce
        texels, detail = light.texels, light.detail if filtered else _ANY_SIZE
        levels = texels.finest(least_bearable(detail, float(points.alpha.min()))) + 1
        _sum_lobes(
            (points.normal, points.view, points.alpha, points.dielectric, points.metal),
            (texels.rows, texels.packed, texels.start[:levels], texels.size[:levels]),
            (light.cone, light.moment, cluster_rows(light.clusters), light.edge),
            (nothing if hidden is None else hidden, glow),
            (
                np.float32(detail),
                np.float32(WIDEN if filtered else 0.0),
                points.disney,
                texels.coarsest if filtered else 0,
                np.float32(texels.most_spread),
            ),
            out,
        )
    return out


def least_bearable(detail: float, alpha: float) -> float:
    """Size, rad, of the texels that lobes of that width bear at their cores; see _choose."""
    return detail * 2 * alpha * LEAST_COSINE


def cluster_rows(clusters: Clusters) -> F32:
    """Clusters as texels: rows [8, C], as `Texels.rows`."""
    return np.concatenate([clusters.direction, clusters.energy, clusters.solid_angle[None], clusters.spread[None]])


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _sum_lobes(points, texels, clusters, blocked, sizes, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    count, parts = points[2].shape[0], clusters[0].shape[1]
    for group in prange((count + _GROUP - 1) // _GROUP):
        facing, bearable = np.empty(parts, dtype=np.float32), np.empty(parts, dtype=np.float32)
        found = np.empty(parts + 1, dtype=np.intp)
        behind, mask = np.zeros(parts, dtype=np.uint8), np.empty(parts, dtype=np.uint8)
        choice = (facing, np.empty(parts, dtype=np.int32), behind, bearable)
        places = (mask, found, np.empty((parts, 2), np.int32), np.empty((parts + 1) * _FEW, np.int32))
        frame = np.empty(12, dtype=np.float32)
        packed, glow = np.empty((8, _STRIDE // 2), dtype=np.float64), clusters[2].copy()
        scratch = (packed, packed.view(np.float32), glow, np.empty(COLUMNS, dtype=np.float32), glow.copy())
        for p in range(group * _GROUP, min(count, (group + 1) * _GROUP)):
            _one_pixel(p, points, texels, clusters, blocked, sizes, scratch, choice, places, frame, out)


@kernel
def _one_pixel(p, points, texels, clusters, blocked, sizes, scratch, choice, places, frame, results):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    normal, view, alpha, dielectric, metal = points
    cone, start = clusters[0], texels[2]
    facing, level, behind, bearable = choice
    out = results[p]
    set_frame(normal[0, p], normal[1, p], normal[2, p], view[0, p], view[1, p], view[2, p], frame)
    frame[11] = alpha[p]
    widen = sizes[1] / max(frame[9], np.float32(LEAST_COSINE))
    shut = _hide(blocked[0], p, behind)
    diffuse, broad = DISNEY if sizes[2] else LAMBERT, is_broad(frame, widen * sizes[4])
    _choose(frame, sizes, texels[3], cone, clusters[2], facing, level, bearable)
    if sizes[2]:
        level[:] = 0
        listed = _in_sight(start, cone, facing, behind, level, places)
        _choose(frame, sizes, texels[3], cone, clusters[2], facing, level, bearable)
    elif sizes[3] < 0:
        _clamped_cosine(clusters[1], clusters[3], behind, frame, out)
        listed = 0, 0
    else:
        _above_the_horizon(cone, clusters[1], facing, behind, frame, out)
        listed = _at_the_horizon(start, cone, facing, behind, level, places)
    _sum_blocks(texels, places, listed, scratch, (diffuse, False, False, False), frame, widen, out)
    listed = _in_sight(start, cone, facing, behind, level, places)
    wanted = (NO_DIFFUSE, dielectric[p] != 0, metal[p] != 0, broad)
    _sum_blocks(texels, places, listed, scratch, wanted, frame, widen, out)
    if sizes[3] < 0:
        _whole(clusters[2], choice, frame, widen, wanted, scratch[4], out)
    for k in range(4):  # so far nothing that is hidden
        out[12 + k] = _RED * out[3 * k] + _GREEN * out[3 * k + 1] + _BLUE * out[3 * k + 2]
    if shut:
        wanted = (diffuse, dielectric[p] != 0, metal[p] != 0, False)
        _glow(p, clusters[2], behind, blocked[1], frame, widen, wanted, scratch[2], scratch[3], out)
    scale_lobes(out)


@kernel
def _hide(hidden, p, behind):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which clusters pixel p does not see; how many."""
    shut = 0
    if hidden.shape[0] > 0:
        for c in range(behind.shape[0]):
            behind[c] = hidden[p, c]
            shut += behind[c]
    return shut


@kernel
def _choose(frame, sizes, size, cone, whole, facing, level, bearable):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes n.l of every cluster and the coarsest level whose texels are small beside the lobe there.

    Level -1 is the cluster itself, where the horizon does not cut it. A lobe about the mirror direction is 2 alpha
    wide, n.v times that across the plane of incidence. Its tail a distance d from there varies over d; it holds the
    less light the farther out, and bears larger texels for that.
    """
    nv, tv, alpha = frame[9], frame[10], frame[11]
    mx, my, mz = nv * frame[0] - tv * frame[3], nv * frame[1] - tv * frame[4], nv * frame[2] - tv * frame[5]
    core = _TWO * alpha * max(nv, np.float32(LEAST_COSINE))
    nx, ny, nz, detail, growth = frame[0], frame[1], frame[2], sizes[0], np.float32(TAIL) / core
    for c in range(facing.shape[0]):
        x, y, z, sine = cone[0, c], cone[1, c], cone[2, c], cone[3, c]
        facing[c] = x * nx + y * ny + z * nz
        away = max(math.sqrt(max(_TWO - _TWO * (x * mx + y * my + z * mz), _ZERO)) - sine, _ZERO)
        bearable[c] = detail * (core + away) * (_ONE + growth * away)
    for c in range(facing.shape[0]):
        level[c] = sizes[3]
    if sizes[3] < 0:
        for c in range(facing.shape[0]):
            coarse = (whole[6, c] <= bearable[c] * bearable[c]) & (abs(facing[c]) > cone[3, c])
            level[c] += not coarse
    for k in range(size.shape[0] - 1):
        for c in range(facing.shape[0]):
            level[c] += size[k, c] > bearable[c]


@kernel
def _at_the_horizon(start, cone, facing, behind, level, places):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Lists the blocks, at their levels, of clusters that the horizon cuts: how many runs and single blocks."""
    mask = places[0]
    for c in range(facing.shape[0]):
        mask[c] = (behind[c] == 0) & (abs(facing[c]) <= cone[3, c])
    return _list_blocks(start, level, places)


@kernel
def _in_sight(start, cone, facing, behind, level, places):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Lists the blocks, at their levels, of clusters that are up and not hidden: how many runs and single blocks."""
    mask = places[0]
    for c in range(facing.shape[0]):
        mask[c] = (behind[c] == 0) & (level[c] >= 0) & (facing[c] > -cone[3, c])
    return _list_blocks(start, level, places)


@kernel
def _list_blocks(start, level, places):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Lists the blocks of masked clusters: more than _FEW of one cluster as a run, else one by one.

    _FEW places are written whatever there is: a loop of an unknown length would be guessed wrong most of the time.
    """
    mask, found, runs, blocks = places
    used = count = 0
    for i in range(_numbers(mask, found)):
        c = found[i]
        first, last = start[level[c], c], start[level[c], c + 1]
        if last - first > _FEW:
            used = _append(runs, used, first, last)
            continue
        at, block = np.uintp(count), np.int32(first)
        blocks[at], blocks[at + _1] = block, block + np.int32(1)
        blocks[at + _2], blocks[at + _3] = block + np.int32(2), block + np.int32(3)
        count += last - first
    return used, count


@inlined
def _numbers(mask, found):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which entries of a mask are set: how many. A branch would be guessed wrong half of the time."""
    count = 0
    for c in range(mask.shape[0]):
        found[count] = c
        count += mask[c]
    return count


@kernel
def _whole(whole, choice, frame, widen, wanted, rows, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds clusters in sight that are read as one texel each: all are summed, the others without light or size.

    That takes a third of the time of gathering the ones that count. `rows` holds the clusters' directions and spreads.
    """
    facing, level, behind = choice[0], choice[1], choice[2]
    for c in range(behind.shape[0]):
        on = _ONE if (behind[c] == 0) & (level[c] < 0) & (facing[c] > _ZERO) else _ZERO
        rows[3, c], rows[4, c] = on * whole[3, c], on * whole[4, c]
        rows[5, c], rows[6, c] = on * whole[5, c], on * whole[6, c]
    add_lobes(frame, widen, rows, 0, behind.shape[0], (NO_DIFFUSE, wanted[1], wanted[2], False), out)


@inlined
def _append(runs, used, first, last):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds a run or lengthens the last one: how many there are."""
    if used > 0 and runs[used - 1, 1] == first:
        runs[used - 1, 1] = last
        return used
    runs[used, 0], runs[used, 1] = first, last
    return used + 1


@kernel
def _sum_blocks(texels, places, listed, scratch, wanted, frame, widen, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Sums runs of blocks where they lie, and single blocks gathered in the scratch."""
    rows, source, target, gathered = texels[0], texels[1], scratch[0], scratch[1]
    runs, blocks = places[2], places[3]
    used, count = listed
    for i in range(used):
        add_lobes(frame, widen, rows, 8 * runs[i, 0], 8 * runs[i, 1], wanted, out)
    for first in range(0, count, _SCRATCH // 8):
        full = min(count - first, _SCRATCH // 8)
        for k in range(full):
            _copy_block(source, np.uintp(blocks[first + k]), target, np.uintp(4 * k))
        add_lobes(frame, widen, gathered, 0, 8 * full, wanted, out)


@inlined
def _copy_block(source, at, target, on):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Copies four words of each row; unsigned places, since one that may be negative keeps LLVM from joining them."""
    for k in range(8):
        word = np.uintp(4 * k)
        one, two = source[at, word], source[at, word + _1]
        three, four = source[at, word + _2], source[at, word + _3]
        target[k, on], target[k, on + _1], target[k, on + _2], target[k, on + _3] = one, two, three, four


@kernel
def _clamped_cosine(moment, edge, behind, frame, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds the irradiance, and that of white, of clusters that pass the horizon as even squares: PreparedLight.edge."""
    nx, ny, nz = frame[0], frame[1], frame[2]
    red = green = blue = white = _ZERO
    for c in range(behind.shape[0]):
        on = _ONE if behind[c] == 0 else _ZERO
        red += on * _clamped(moment[0, c] * nx + moment[1, c] * ny + moment[2, c] * nz, edge[0, c], edge[4, c])
        green += on * _clamped(moment[3, c] * nx + moment[4, c] * ny + moment[5, c] * nz, edge[1, c], edge[5, c])
        blue += on * _clamped(moment[6, c] * nx + moment[7, c] * ny + moment[8, c] * nz, edge[2, c], edge[6, c])
        white += on * _clamped(moment[9, c] * nx + moment[10, c] * ny + moment[11, c] * nz, edge[3, c], edge[7, c])
    out[0] += red
    out[1] += green
    out[2] += blue
    out[16] += white


@inlined
def _clamped(mean, half, over):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The mean of max(x, 0) for x even on mean - half to mean + half, `over` being 1 / (4 half)."""
    part = min(max(mean + half, _ZERO), half + half)
    return part * part * over + max(mean - half, _ZERO)


@kernel
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


@kernel
def _glow(p, whole, behind, bounce, frame, widen, wanted, rows, open_, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds what hidden clusters glow with, one direction each, and what would come from there in the open."""
    count = behind.shape[0]
    for c in range(count):
        rows[6, c] = behind[c] * whole[6, c]
        rows[3, c] = behind[c] * (_RED * whole[3, c] + _GREEN * whole[4, c] + _BLUE * whole[5, c])
    open_[:] = _ZERO
    add_lobes(frame, widen, rows, 0, count, wanted, open_)
    for k in range(3):
        if bounce.shape[1] > 0:
            for c in range(count):
                rows[3 + k, c] = rows[6, c] * bounce[k, p, c]
        else:
            rows[3 + k, :] = _ZERO
    add_lobes(frame, widen, rows, 0, count, wanted, out)
    for k in range(4):
        out[12 + k] += open_[3 * k]
