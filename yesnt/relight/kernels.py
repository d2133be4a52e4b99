"""The full sum over a light's texels: what each pixel sums. How a texel is summed is in lobes.py.

A pixel first chooses what it sums: nothing of clusters below its horizon, one direction for clusters that are hidden
(they glow with what bounces), and of all others texels of a size that its lobe can bear. Short runs of these are copied
into a scratch that stays in the cache, whose loops have no branch (texel_lod.py). Irradiance needs no texels but at the
horizon of a map that has few clusters or whose every cell is a texel (irradiance.py).

Every lobe is linear in what later multiplies it, so one pass serves both relighting and the removal of capture light.
Results do not depend on the number of threads: a pixel is summed by one thread in one order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709
from yesnt.relight.compiled import inlined, kernel
from yesnt.relight.irradiance import above_the_horizon, clamped_cosine
from yesnt.relight.lights import Clusters, PreparedLight
from yesnt.relight.lobes import DISNEY, LAMBERT, NO_DIFFUSE, add_lobes, is_broad, scale_lobes, set_frame
from yesnt.relight.texel_lod import FEW, LEAST_COSINE, at_the_horizon, choose, in_sight, least_bearable

F32 = NDArray[np.float32]

_GROUP = 32  # pixels that share a scratch allocation
_SCRATCH = 1024  # texels gathered at a time: 32 kB
_STRIDE = 1040  # floats from row to row of the scratch: rows a power of two apart share a cache set
_ANY_SIZE = 1e9  # a `detail` that level 0 always meets; infinity is not a number that fast arithmetic knows
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
        choice = (facing, np.empty(parts, np.int32), behind, bearable, np.zeros(parts, np.int32))
        places = (mask, found, np.empty((parts, 2), np.int32), np.empty((parts + 1) * FEW, np.int32))
        frame = np.empty(12, dtype=np.float32)
        packed, glow = np.empty((8, _STRIDE // 2), dtype=np.float64), clusters[2].copy()
        scratch = (packed, packed.view(np.float32), glow, np.empty(COLUMNS, dtype=np.float32), glow.copy())
        for p in range(group * _GROUP, min(count, (group + 1) * _GROUP)):
            _one_pixel(p, points, texels, clusters, blocked, sizes, scratch, choice, places, frame, out)


@kernel
def _one_pixel(p, points, texels, clusters, blocked, sizes, scratch, choice, places, frame, results):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    normal, view, alpha, dielectric, metal = points
    cone, start = clusters[0], texels[2]
    facing, level, behind, bearable, ground = choice
    out = results[p]
    set_frame(normal[0, p], normal[1, p], normal[2, p], view[0, p], view[1, p], view[2, p], frame)
    frame[11] = alpha[p]
    widen = sizes[1] / max(frame[9], np.float32(LEAST_COSINE))
    shut = _hide(blocked[0], p, behind)
    diffuse, broad = DISNEY if sizes[2] else LAMBERT, is_broad(frame, widen * sizes[4])
    choose(frame, sizes, texels[3], cone, clusters[2], facing, level, bearable)
    if sizes[2]:
        level[:] = 0
        listed = in_sight(start, cone, facing, behind, level, places)
        choose(frame, sizes, texels[3], cone, clusters[2], facing, level, bearable)
    elif sizes[3] < 0 and clusters[3].shape[1] > 0:
        clamped_cosine(clusters[1], clusters[3], behind, frame, out)
        listed = 0, 0
    else:
        above_the_horizon(cone, clusters[1], facing, behind, frame, out)
        listed = at_the_horizon(start, cone, facing, behind, ground, places)
    _sum_blocks(texels, places, listed, scratch, (diffuse, False, False, False), frame, widen, out)
    listed = in_sight(start, cone, facing, behind, level, places)
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
