"""Lobe sums of several levels of roughness towards one viewer, for the evidence of a capture.

The same sums as `kernels.sum_lobes` makes of each level by itself, for Lambert's diffuse below a dielectric layer and
for a metal, normalised by exact albedos (relight/combine.py). What levels share is computed once per point: occlusion,
irradiance, half vectors and Fresnel terms of whole clusters. Both specular lobes are summed in one loop, and occluded
clusters, which are one texel each, in that of the whole clusters. Each point is summed by one thread in one order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.brdf import COS_MIN
from yesnt.relight.compiled import entry, inlined, kernel
from yesnt.relight.kernels import BATCH, COLUMNS, WIDEN, add_diffuse, cluster_rows, copy_block
from yesnt.relight.level_records import LevelPoints, LevelSums, LevelTerms
from yesnt.relight.lights import PreparedLight
from yesnt.relight.lobes import add_both_broad, add_both_narrow, add_lobes, is_broad
from yesnt.relight.microfacet import (
    HalfVector,
    fresnel_dielectric,
    fresnel_schlick_weight,
    half_vector,
    inverse_ggx_d,
    inverse_smith_g2,
    microfacet_lobe,
    smith_view_term,
)
from yesnt.relight.proxy import OPEN
from yesnt.relight.ranges import over_ranges
from yesnt.relight.records import (
    BLUE,
    GREEN,
    LAMBERT,
    RED,
    SOLID_ANGLE,
    SPREAD,
    ClusterArrays,
    Lobes,
    Sampling,
    Scratch,
    TexelArrays,
    X,
    Y,
    Z,
    new_scratch,
)
from yesnt.relight.shading_frame import FRAME_SIZE, Vector, load_frame, store_frame
from yesnt.relight.texel_lod import LEAST_COSINE, TAIL, least_bearable, list_blocks

F32 = NDArray[np.float32]

_OPEN = np.int32(OPEN)
_0 = np.uintp(0)
_ONE, _TWO, _ZERO = np.float32(1.0), np.float32(2.0), np.float32(0.0)
_NO = np.bool_(False)
_NOTHING = 1e-19  # white sum below which a lobe has met no texel (combine.normalise)
_ALPHA = 11  # place of alpha_ggx in a stored frame (shading_frame.store_frame)


class _Shared(NamedTuple):
    """What a point's levels share; one column for each cluster.

    Attributes:
        base: Scratch of the other kernels.
        away: [C] angle from the mirrored view to the cluster, rad.
        half: [6, C] HalfVector, then Fresnel of the dielectric and Schlick's weight.
        on: [C] 1 where the cluster is read as one texel.
        sums: [20] of a level.
        diffuse: [20] of all levels.
    """

    base: Scratch
    away: F32
    half: F32
    on: F32
    sums: F32
    diffuse: F32


class _Light(NamedTuple):
    """A light as the kernels read it, with [R] the number of texel levels that each level of roughness needs."""

    texels: TexelArrays
    clusters: ClusterArrays
    sampling: Sampling
    finest: NDArray[np.int64]
    shown: F32


def sum_levels(points: LevelPoints, light: PreparedLight, shown: F32, terms: LevelTerms) -> LevelSums:
    """Responses of P points towards one camera at R levels of roughness.

    Args:
        points: as the camera sees them.
        light: with C clusters.
        shown: [F + 1, 3] radiance that each triangle of the proxy sends; the last row is 0.
        terms: of the levels.
    """
    count, levels = points.alpha.shape
    diffuse, dielectric, f0, f90 = (np.zeros((count, levels, 3), np.float32) for _ in range(4))
    out = LevelSums(diffuse, dielectric, f0, f90, np.zeros((count, levels), np.float32))
    if count == 0:
        return out
    arrays = _arrays(light, shown, points.alpha.min(axis=0))

    def run(first: int, last: int) -> None:
        rows, size = arrays.clusters.rows, len(light.clusters)
        memory = _Shared(
            new_scratch(rows, COLUMNS, FRAME_SIZE), np.empty(size, np.float32), np.empty((6, size), np.float32),
            np.empty(size, np.float32), np.empty(COLUMNS, np.float32), np.empty(COLUMNS, np.float32),
        )  # fmt: skip
        _sum_points((first, last), points, arrays, terms, memory, out)

    over_ranges(count, run)
    return out


def _arrays(light: PreparedLight, shown: F32, alpha: F32) -> _Light:
    """The light for levels whose sharpest lobes are [R] wide."""
    texels, detail = light.texels, light.detail
    finest = np.array([texels.finest(least_bearable(detail, float(a))) + 1 for a in alpha])
    most = int(finest.max())
    arrays = TexelArrays(texels.rows, texels.packed, texels.start[:most], texels.size[:most])
    clusters = ClusterArrays(light.cone, light.moment, cluster_rows(light.clusters), light.edge)
    sampling = Sampling(np.float32(detail), np.float32(WIDEN), texels.coarsest, np.float32(texels.most_spread))
    return _Light(arrays, clusters, sampling, finest, np.ascontiguousarray(shown, np.float32))


@entry
def _sum_points(which, points, light, terms, memory, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the responses of a range of points (first, last) to `out`."""
    for p in range(which[0], which[1]):
        frame = memory.base.frame
        normal = Vector(points.normal[p, 0], points.normal[p, 1], points.normal[p, 2])
        view = Vector(points.viewer[p, 0], points.viewer[p, 1], points.viewer[p, 2])
        store_frame(normal, view, points.alpha[p, 0], frame)
        _share_directions(light.clusters, frame, memory)
        for sharp in range(2):
            first, last = (0, points.sharp) if sharp == 0 else (points.sharp, points.alpha.shape[1])
            if first == last:
                continue
            occluded = _read_hits(p, points, light, sharp == 0, memory.base)
            _sum_diffuse(light, occluded, memory)
            for r in range(first, last):
                frame[_ALPHA] = points.alpha[p, r]
                _sum_level(r, light, memory)
                _finish(p, r, terms, memory, out)


@kernel
def _share_directions(clusters, stored_frame, memory):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes n.l, the angle to the mirrored view, half vectors and Fresnel terms of all clusters."""
    frame, cone, rows = load_frame(stored_frame), clusters.cone, clusters.rows
    n, t, nv, tv = frame.normal, frame.tangent, frame.cos_o, frame.sin_o
    mx, my, mz = nv * n.x - tv * t.x, nv * n.y - tv * t.y, nv * n.z - tv * t.z  # mirrored view
    cosine, away, half = memory.base.state.cosine, memory.away, memory.half
    for c in range(cosine.shape[0]):
        x, y, z = cone[0, c], cone[1, c], cone[2, c]
        cosine[c] = x * n.x + y * n.y + z * n.z
        away[c] = max(math.sqrt(max(_TWO - _TWO * (x * mx + y * my + z * mz), _ZERO)) - cone[3, c], _ZERO)
    for c in range(cosine.shape[0]):
        one = half_vector(frame, Vector(rows[X, c], rows[Y, c], rows[Z, c]))
        half[0, c], half[1, c], half[2, c], half[3, c] = one.cos_i, one.tangent2, one.normal2, one.length2
        half[4, c], half[5, c] = fresnel_dielectric(one.length2), fresnel_schlick_weight(one.length2)


@kernel
def _read_hits(p, points, light, sharp, scratch):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which clusters are occluded for point p and the energy that comes from there; returns how many."""
    hidden, occluded, rows, shown = scratch.state.hidden, scratch.occluded, light.clusters.rows, light.shown
    own = points.own[p] if sharp else -1
    count = 0
    for c in range(hidden.shape[0]):
        hit = points.mirrored[p] if c == own else points.hits[p, c]
        hidden[c] = hit != _OPEN
        count += hidden[c]
        solid = rows[SOLID_ANGLE, c] if hit != _OPEN else _ZERO
        occluded[RED, c], occluded[GREEN, c] = solid * shown[hit, 0], solid * shown[hit, 1]
        occluded[BLUE, c], occluded[SOLID_ANGLE, c] = solid * shown[hit, 2], solid
    return count


@kernel
def _sum_diffuse(light, occluded, memory):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the irradiance."""
    scratch, sums = memory.base, memory.diffuse
    sums[:] = _ZERO
    add_diffuse(light.texels, light.clusters, scratch, LAMBERT, light.sampling.widen, light.sampling, sums)
    if occluded:
        lobes = Lobes(LAMBERT, _NO, _NO, _NO)
        count = np.uintp(scratch.state.hidden.shape[0])
        add_lobes(scratch.frame, light.sampling.widen, scratch.occluded, _0, count, lobes, sums)


@kernel
def _sum_level(r, light, memory):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the specular sums of a level of roughness, the alpha of which is in the frame; times 2 pi."""
    scratch, sums = memory.base, memory.sums
    sums[:] = _ZERO
    frame = load_frame(scratch.frame)
    widen = light.sampling.widen / max(frame.cos_o, np.float32(LEAST_COSINE))
    finer = _choose(light.finest[r], light, memory)
    if finer:
        used, count = list_blocks(light.texels.start, scratch.state.level, scratch.listed)
        broad = is_broad(scratch.frame, widen * light.sampling.most_spread)
        _add_finer(light.texels, (used, count), broad, widen, scratch, sums)
    _add_whole(light.clusters.rows, widen, memory, sums)


@kernel
def _add_finer(texels, listed, broad, widen, scratch, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds both specular lobes of the listed texels: numbers of runs and of single blocks (kernels._add_blocks)."""
    runs, blocks, frame = scratch.listed.runs, scratch.listed.blocks, scratch.frame
    for i in range(listed[0]):
        first, last = np.uintp(8 * runs[i, 0]), np.uintp(8 * runs[i, 1])
        _add_both(frame, widen, texels.rows, first, last, broad, sums)
    for begin in range(0, listed[1], BATCH):
        full = min(listed[1] - begin, BATCH)
        for k in range(full):
            copy_block(texels.words, np.uintp(blocks[begin + k]), scratch.words, np.uintp(4 * k))
        _add_both(frame, widen, scratch.texels, _0, np.uintp(8 * full), broad, sums)


@kernel
def _add_both(frame, widen, rows, first, last, broad, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds both specular lobes, in their cheaper form if they are broad."""
    if broad:
        add_both_broad(frame, widen, rows, first, last, sums)
    else:
        add_both_narrow(frame, widen, rows, first, last, sums)


@kernel
def _choose(finest, light, memory):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Chooses the level of texels of every cluster (texel_lod.choose_levels) and masks those of finer levels.

    Writes `on`, `level` and `mask` and returns how many clusters are read as more than one texel.
    """
    state, size, cone, rows = memory.base.state, light.texels.size, light.clusters.cone, light.clusters.rows
    frame, sampling, mask, on = load_frame(memory.base.frame), light.sampling, memory.base.listed.mask, memory.on
    core = _TWO * frame.alpha * max(frame.cos_o, np.float32(LEAST_COSINE))
    growth = np.float32(TAIL) / core
    cosine, level, bearable, hidden = state.cosine, state.level, state.bearable, state.hidden
    for c in range(cosine.shape[0]):
        bearable[c] = sampling.detail * (core + memory.away[c]) * (_ONE + growth * memory.away[c])
        level[c] = sampling.coarsest
    if sampling.coarsest < 0:
        for c in range(cosine.shape[0]):
            enough = (rows[SOLID_ANGLE, c] <= bearable[c] * bearable[c]) & (abs(cosine[c]) > cone[3, c])
            level[c] += not enough
    for k in range(finest - 1):
        for c in range(cosine.shape[0]):
            level[c] += size[k, c] > bearable[c]
    count = 0
    for c in range(cosine.shape[0]):
        mask[c] = (hidden[c] == 0) & (level[c] >= 0) & (cosine[c] > -cone[3, c])
        on[c] = _ONE if (hidden[c] == 0) & (level[c] < 0) & (cosine[c] > _ZERO) else _ZERO
        count += mask[c]
    return count


@kernel
def _add_whole(rows, widen, memory, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds both specular lobes of clusters that are read as one texel, and of occluded ones."""
    frame, half, on, occluded = load_frame(memory.base.frame), memory.half, memory.on, memory.base.occluded
    a2 = frame.alpha * frame.alpha
    view_term = smith_view_term(frame.cos_o, a2)
    red = green = blue = white = _ZERO
    red_d = green_d = blue_d = white_d = _ZERO
    red_90 = green_90 = blue_90 = white_90 = _ZERO
    for c in range(on.shape[0]):
        one = HalfVector(half[0, c], half[1, c], half[2, c], half[3, c])
        inverse_d = inverse_ggx_d(one, a2, widen * rows[SPREAD, c])
        value = microfacet_lobe(one, a2, inverse_d, inverse_smith_g2(one.cos_i, frame.cos_o, a2, view_term))
        dielectric, f90 = value * half[4, c], value * half[5, c]
        r, g = on[c] * rows[RED, c] + occluded[RED, c], on[c] * rows[GREEN, c] + occluded[GREEN, c]
        b, w = on[c] * rows[BLUE, c] + occluded[BLUE, c], on[c] * rows[SOLID_ANGLE, c] + occluded[SOLID_ANGLE, c]
        red, green, blue, white = red + value * r, green + value * g, blue + value * b, white + value * w
        red_d, green_d = red_d + dielectric * r, green_d + dielectric * g
        blue_d, white_d = blue_d + dielectric * b, white_d + dielectric * w
        red_90, green_90, blue_90, white_90 = (
            red_90 + f90 * r,
            green_90 + f90 * g,
            blue_90 + f90 * b,
            white_90 + f90 * w,
        )
    sums[3], sums[4], sums[5], sums[17] = sums[3] + red_d, sums[4] + green_d, sums[5] + blue_d, sums[17] + white_d
    sums[6], sums[7] = sums[6] + red - red_90, sums[7] + green - green_90
    sums[8], sums[18] = sums[8] + blue - blue_90, sums[18] + white - white_90
    sums[9], sums[10], sums[11], sums[19] = (
        sums[9] + red_90,
        sums[10] + green_90,
        sums[11] + blue_90,
        sums[19] + white_90,
    )


@kernel
def _finish(p, r, terms, memory, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes normalised responses (combine.normalise, albedo.energy_terms)."""
    sums, irradiance = memory.sums, memory.diffuse
    last = terms.white.shape[1] - 1
    place = math.sqrt(min(max(memory.base.frame[9], np.float32(COS_MIN)), _ONE)) * last
    low = min(int(place), last - 1)
    share = place - low
    white = terms.white[r, low] * (1 - share) + terms.white[r, low + 1] * share
    dielectric = terms.dielectric[r, low] * (1 - share) + terms.dielectric[r, low + 1] * share
    schlick = terms.schlick[r, low] * (1 - share) + terms.schlick[r, low + 1] * share
    bounded = max(white, 1e-3)
    missing = max((1 - bounded) / bounded, 0.0)
    factor = 1 + terms.scattering[r] * missing
    layer = 1 - factor * dielectric
    body = layer * _over(1.0, irradiance[16])
    coat = factor * _over(dielectric, sums[17])
    f0, f90 = _over(white - schlick, sums[18]), _over(schlick, sums[19])
    for k in range(3):
        out.diffuse[p, r, k] = body * irradiance[k]
        out.dielectric[p, r, k] = coat * sums[3 + k]
        out.metal_f0[p, r, k] = f0 * sums[6 + k]
        out.metal_f90[p, r, k] = f90 * sums[9 + k]
    out.missing[p, r] = missing


@inlined
def _over(exact, found):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The factor that brings a white sum to its exact albedo; 0 where no texel was met."""
    return exact / found if found > _NOTHING else 0.0
