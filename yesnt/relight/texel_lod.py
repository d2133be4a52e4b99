"""Texel level of detail: which level of texels each pixel reads of each cluster, and which blocks that makes.

All clusters are evaluated at once, in vector lanes. Only those that are then listed are visited one by one.
"""

from __future__ import annotations

import math

import numpy as np

from yesnt.relight.compiled import inlined, kernel
from yesnt.relight.records import FEW, SOLID_ANGLE
from yesnt.relight.shading_frame import load_frame

TAIL = 0.08
"""Growth of the texels that a lobe bears, for each of its widths that they lie away from its core."""

LEAST_COSINE = 0.3
"""n.v below which a lobe is taken to grow no narrower across the plane of incidence: it grows longer along it."""

_1, _2, _3 = np.uintp(1), np.uintp(2), np.uintp(3)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)


def least_bearable(detail: float, alpha: float) -> float:
    """Size, rad, of the texels that lobes of width `alpha` (alpha_ggx) bear at their cores; see `choose_levels`."""
    return detail * 2 * alpha * LEAST_COSINE


@kernel
def choose_levels(stored_frame, sampling, size, clusters, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Writes n.l of every cluster and the coarsest level whose texels are small compared with the lobe there.

    A lobe about the mirror direction is 2 alpha wide, and n.v times that across the plane of incidence. At a distance d
    from its core it varies over d; it holds less light the farther out, so that larger texels suffice. Level -1 is the
    cluster as one texel, and is taken only if the horizon does not cut the cluster.

    Args:
        stored_frame: [12] ShadingFrame.
        sampling: Sampling.
        size: [L, C] mean angular size of the texels, rad.
        clusters: ClusterArrays.
        state: ClusterState; `cosine`, `bearable` and `level` are written.
    """
    frame, cone, whole = load_frame(stored_frame), clusters.cone, clusters.rows
    n, t = frame.normal, frame.tangent
    nv, tv, detail = frame.cos_o, frame.sin_o, sampling.detail
    mx, my, mz = nv * n.x - tv * t.x, nv * n.y - tv * t.y, nv * n.z - tv * t.z  # mirrored view
    core = _TWO * frame.alpha * max(nv, np.float32(LEAST_COSINE))
    growth = np.float32(TAIL) / core
    cosine, level, bearable = state.cosine, state.level, state.bearable
    for c in range(cosine.shape[0]):
        x, y, z, sine = cone[0, c], cone[1, c], cone[2, c], cone[3, c]
        cosine[c] = x * n.x + y * n.y + z * n.z
        away = max(math.sqrt(max(_TWO - _TWO * (x * mx + y * my + z * mz), _ZERO)) - sine, _ZERO)
        bearable[c] = detail * (core + away) * (_ONE + growth * away)
    for c in range(cosine.shape[0]):
        level[c] = sampling.coarsest
    if sampling.coarsest < 0:
        for c in range(cosine.shape[0]):
            enough = (whole[SOLID_ANGLE, c] <= bearable[c] * bearable[c]) & (abs(cosine[c]) > cone[3, c])
            level[c] += not enough
    for k in range(size.shape[0] - 1):
        for c in range(cosine.shape[0]):
            level[c] += size[k, c] > bearable[c]


@kernel
def list_horizon(start, cone, state, listed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Lists blocks of level 0 of the visible clusters that the horizon cuts.

    Args:
        start: [L, C + 1] first block of each cluster at each level.
        cone: [4, C] of PreparedLight.
        state: ClusterState; `cosine`, `hidden` and `finest` are read.
        listed: BlockList, written.

    Returns:
        Number of runs and number of single blocks.
    """
    for c in range(state.cosine.shape[0]):
        listed.mask[c] = (state.hidden[c] == 0) & (abs(state.cosine[c]) <= cone[3, c])
    return list_blocks(start, state.finest, listed)


@kernel
def list_visible(start, cone, state, level, listed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Lists the blocks, at their levels, of the visible clusters that are above the horizon at least in part.

    Args:
        start: [L, C + 1] first block of each cluster at each level.
        cone: [4, C] of PreparedLight.
        state: ClusterState; `cosine` and `hidden` are read.
        level: [C] level of each cluster; those of level -1 are left out.
        listed: BlockList, written.

    Returns:
        Number of runs and number of single blocks.
    """
    for c in range(state.cosine.shape[0]):
        listed.mask[c] = (state.hidden[c] == 0) & (level[c] >= 0) & (state.cosine[c] > -cone[3, c])
    return list_blocks(start, level, listed)


@kernel
def list_blocks(start, level, listed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Lists the blocks of masked clusters: more than FEW of one cluster as a run, else one by one.

    FEW numbers are always written: the branch predictor would miss the end of a loop of unknown length mostly.
    """
    runs, blocks = listed.runs, listed.blocks
    used = count = 0
    for i in range(_numbers(listed.mask, listed.clusters)):
        c = listed.clusters[i]
        first, last = start[level[c], c], start[level[c], c + 1]
        if last - first > FEW:
            used = _append(runs, used, first, last)
            continue
        at, block = np.uintp(count), np.int32(first)
        blocks[at], blocks[at + _1] = block, block + np.int32(1)
        blocks[at + _2], blocks[at + _3] = block + np.int32(2), block + np.int32(3)
        count += last - first
    return used, count


@inlined
def _numbers(mask, numbers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which entries of a mask are set and returns how many; without a branch, which would often be missed."""
    count = 0
    for c in range(mask.shape[0]):
        numbers[count] = c
        count += mask[c]
    return count


@inlined
def _append(runs, used, first, last):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds a run or lengthens the last one; returns the number of runs."""
    if used > 0 and runs[used - 1, 1] == first:
        runs[used - 1, 1] = last
        return used
    runs[used, 0], runs[used, 1] = first, last
    return used + 1
