"""Sums of a light's texels over the lobes of every pixel (docs/method.md section 5).

For each pixel, occluded clusters of the light are one direction each, from which indirect radiance comes instead.
Clusters below the horizon are skipped. Of all others, texels are read that are small compared with the lobe
(relight/texel_lod.py). Single blocks of texels are copied to a scratch that stays in the cache, so that the loops over
texels (relight/lobes.py) have no branch. Irradiance comes from the clusters where they suffice (relight/irradiance.py).

Every lobe is linear in what later multiplies it, so that one pass serves relighting and the removal of capture light.
Each pixel is summed by one thread in one order: results do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709
from yesnt.relight.compiled import entry, inlined, kernel
from yesnt.relight.irradiance import add_clamped_clusters, add_clusters_above
from yesnt.relight.lights import Clusters, PreparedLight
from yesnt.relight.lobes import add_lobes, is_broad, scale_lobes
from yesnt.relight.ranges import over_ranges
from yesnt.relight.records import (
    BLUE,
    DISNEY,
    GREEN,
    LAMBERT,
    NO_DIFFUSE,
    RED,
    SCRATCH_TEXELS,
    SOLID_ANGLE,
    ClusterArrays,
    Lobes,
    Occlusion,
    Sampling,
    ShadingPoints,
    TexelArrays,
    new_scratch,
)
from yesnt.relight.shading_frame import FRAME_SIZE, Vector, load_frame, store_frame
from yesnt.relight.texel_lod import LEAST_COSINE, choose_levels, least_bearable, list_horizon, list_visible

F32 = NDArray[np.float32]

BATCH = SCRATCH_TEXELS // 8
"""Blocks of texels that are gathered at a time."""

_ANY_SIZE = 1e9  # a `detail` that level 0 always meets; fast arithmetic has no infinity
_0, _1, _2, _3 = np.uintp(0), np.uintp(1), np.uintp(2), np.uintp(3)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_NO = np.bool_(False)
_RED_WEIGHT, _GREEN_WEIGHT, _BLUE_WEIGHT = (np.float32(w) for w in LUMINANCE_REC709)

IRRADIANCE, DIELECTRIC, METAL_F0, METAL_F90 = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Columns of the lobe sums: R, G, B each."""

LIT = slice(0, 12)
"""All of them."""

OPEN_LIGHT = slice(12, 16)
"""The same four sums of luminance without occlusion."""

WHITE = slice(16, 20)
"""The same four sums of uniform radiance 1: the albedo as the texels integrate it, which is known exactly."""

COLUMNS = 20

WIDEN = 0.5
"""Squared radius of a texel's disc of half vectors over its angular variance, times n.v: a disc's variance is half its
squared radius, and half vectors fill 1 / (4 v.h) of the solid angle of the light (Walter 2007, eq. 14)."""


def sum_lobes(
    points: ShadingPoints,
    light: PreparedLight,
    hidden: NDArray[np.bool_] | None,
    indirect: F32 | None,
    filtered: bool = True,
) -> F32:
    """Integrates the light's texels over the lobes of every pixel.

    Args:
        points: P pixels.
        light: the light, with C clusters.
        hidden: [P, C] clusters that are occluded; None: none.
        indirect: [3, P, C] radiance that comes from an occluded cluster's direction instead of its light; None: 0.
        filtered: average each lobe over each texel, and read finer texels where a lobe is sharp; False: point samples
            of level 0.

    Returns:
        [P, 20] float32: irradiance (for `disney` weighted as that diffuse is), dielectric, F0 and F90 parts of the
        metallic lobe (R, G, B each); the four sums of luminance without occlusion; the four sums of uniform white.
    """
    count = points.alpha.shape[0]
    sums = np.zeros((count, COLUMNS), dtype=np.float32)
    if count == 0:
        return sums
    texels, detail = light.texels, light.detail if filtered else _ANY_SIZE
    levels = texels.finest(least_bearable(detail, float(points.alpha.min()))) + 1
    arrays = TexelArrays(texels.rows, texels.packed, texels.start[:levels], texels.size[:levels])
    clusters = ClusterArrays(light.cone, light.moment, cluster_rows(light.clusters), light.edge)
    occlusion = Occlusion(
        np.zeros((0, 0), dtype=np.bool_) if hidden is None else hidden,
        np.zeros((3, 0, 0), dtype=np.float32) if indirect is None else indirect,
    )
    widen, coarsest = (WIDEN, texels.coarsest) if filtered else (0.0, 0)
    sampling = Sampling(np.float32(detail), np.float32(widen), coarsest, np.float32(texels.most_spread))

    def run(first: int, last: int) -> None:
        scratch = new_scratch(clusters.rows, COLUMNS, FRAME_SIZE)
        _sum_pixels((first, last), points, arrays, clusters, occlusion, sampling, scratch, sums)

    over_ranges(count, run)
    return sums


def cluster_rows(clusters: Clusters) -> F32:
    """Clusters as texels: rows [8, C], as `Texels.rows`."""
    return np.concatenate([clusters.direction, clusters.energy, clusters.solid_angle[None], clusters.spread[None]])


@entry
def _sum_pixels(pixels, points, texels, clusters, occlusion, sampling, scratch, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the lobe sums of a range of pixels (first, last)."""
    for p in range(pixels[0], pixels[1]):
        _sum_pixel(p, points, texels, clusters, occlusion, sampling, scratch, sums[p])


@inlined
def _sum_pixel(p, points, texels, clusters, occlusion, sampling, scratch, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds the lobe sums of pixel p to `sums` [20], which are 0."""
    state, stored_frame = scratch.state, scratch.frame
    normal = Vector(points.normal[0, p], points.normal[1, p], points.normal[2, p])
    store_frame(
        normal, Vector(points.viewer[0, p], points.viewer[1, p], points.viewer[2, p]), points.alpha[p], stored_frame
    )
    frame = load_frame(stored_frame)
    widen = sampling.widen / max(frame.cos_o, np.float32(LEAST_COSINE))
    diffuse = DISNEY if points.disney else LAMBERT
    dielectric, metal = points.dielectric[p] != 0, points.metal[p] != 0
    occluded = _read_hidden(occlusion.hidden, p, state.hidden)
    choose_levels(stored_frame, sampling, texels.size, clusters, state)
    add_diffuse(texels, clusters, scratch, diffuse, widen, sampling, sums)
    broad = is_broad(stored_frame, widen * sampling.most_spread)
    used, count = list_visible(texels.start, clusters.cone, state, state.level, scratch.listed)
    _add_blocks(texels, scratch, used, count, Lobes(NO_DIFFUSE, dielectric, metal, broad), widen, sums)
    if sampling.coarsest < 0:
        _add_whole_clusters(clusters.rows, scratch, Lobes(NO_DIFFUSE, dielectric, metal, _NO), widen, sums)
    for k in range(4):  # so far without the light of occluded clusters
        sums[12 + k] = _RED_WEIGHT * sums[3 * k] + _GREEN_WEIGHT * sums[3 * k + 1] + _BLUE_WEIGHT * sums[3 * k + 2]
    if occluded:
        lobes = Lobes(diffuse, dielectric, metal, _NO)
        _add_occluded(p, clusters.rows, occlusion.indirect, scratch, lobes, widen, sums)
    scale_lobes(sums)


@inlined
def _read_hidden(hidden, p, row):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which clusters are occluded for pixel p to `row` [C] and returns how many."""
    count = 0
    if hidden.shape[0] > 0:
        for c in range(row.shape[0]):
            row[c] = hidden[p, c]
            count += row[c]
    return count


@inlined
def add_diffuse(texels, clusters, scratch, diffuse, widen, sampling, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the diffuse lobe of visible clusters."""
    state = scratch.state
    if diffuse == DISNEY:
        used, count = list_visible(texels.start, clusters.cone, state, state.finest, scratch.listed)
    elif sampling.coarsest < 0 and clusters.edge.shape[1] > 0:
        add_clamped_clusters(clusters.moment, clusters.edge, state.hidden, scratch.frame, sums)
        return
    else:
        add_clusters_above(clusters.cone, clusters.moment, state, scratch.frame, sums)
        used, count = list_horizon(texels.start, clusters.cone, state, scratch.listed)
    _add_blocks(texels, scratch, used, count, Lobes(diffuse, _NO, _NO, _NO), widen, sums)


@inlined
def _add_whole_clusters(rows, scratch, lobes, widen, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds visible clusters of level -1. All clusters are summed, the others without light and solid angle.

    That takes a third of the time of gathering those that count. `scratch.whole` holds directions and spreads.
    """
    state, whole = scratch.state, scratch.whole
    for c in range(state.hidden.shape[0]):
        on = _ONE if (state.hidden[c] == 0) & (state.level[c] < 0) & (state.cosine[c] > _ZERO) else _ZERO
        whole[RED, c], whole[GREEN, c] = on * rows[RED, c], on * rows[GREEN, c]
        whole[BLUE, c], whole[SOLID_ANGLE, c] = on * rows[BLUE, c], on * rows[SOLID_ANGLE, c]
    add_lobes(scratch.frame, widen, whole, _0, np.uintp(state.hidden.shape[0]), lobes, sums)


@kernel
def _add_blocks(texels, scratch, used, count, lobes, widen, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds listed blocks: `used` runs where they lie, `count` single blocks gathered in the scratch."""
    runs, blocks = scratch.listed.runs, scratch.listed.blocks
    for i in range(used):
        add_lobes(
            scratch.frame, widen, texels.rows, np.uintp(8 * runs[i, 0]), np.uintp(8 * runs[i, 1]), lobes, sums
        )  # fmt: skip
    for first in range(0, count, BATCH):
        full = min(count - first, BATCH)
        for k in range(full):
            copy_block(texels.words, np.uintp(blocks[first + k]), scratch.words, np.uintp(4 * k))
        add_lobes(scratch.frame, widen, scratch.texels, _0, np.uintp(8 * full), lobes, sums)


@inlined
def copy_block(source, block, target, at):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Copies four words per row. Indices are unsigned: LLVM does not join the copies if one may be negative."""
    for k in range(8):
        word = np.uintp(4 * k)
        one, two = source[block, word], source[block, word + _1]
        three, four = source[block, word + _2], source[block, word + _3]
        target[k, at], target[k, at + _1], target[k, at + _2], target[k, at + _3] = one, two, three, four


@inlined
def _add_occluded(p, rows, indirect, scratch, lobes, widen, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds occluded clusters, one direction each: indirect radiance to what is lit, their light to the open sums."""
    hidden, occluded, open_ = scratch.state.hidden, scratch.occluded, scratch.open
    count = hidden.shape[0]
    for c in range(count):
        luminance = _RED_WEIGHT * rows[RED, c] + _GREEN_WEIGHT * rows[GREEN, c] + _BLUE_WEIGHT * rows[BLUE, c]
        occluded[SOLID_ANGLE, c], occluded[RED, c] = hidden[c] * rows[SOLID_ANGLE, c], hidden[c] * luminance
    open_[:] = _ZERO
    add_lobes(scratch.frame, widen, occluded, _0, np.uintp(count), lobes, open_)
    for k in range(3):
        if indirect.shape[1] > 0:
            for c in range(count):
                occluded[RED + k, c] = occluded[SOLID_ANGLE, c] * indirect[k, p, c]
        else:
            occluded[RED + k, :] = _ZERO
    add_lobes(scratch.frame, widen, occluded, _0, np.uintp(count), lobes, sums)
    for k in range(4):
        sums[12 + k] += open_[3 * k]
