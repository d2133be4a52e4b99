"""What a pixel sums: of every cluster a level of texels, and which blocks that makes.

Clusters are looked at all at once, in lanes; only what is then listed is gone through one by one.
"""

from __future__ import annotations

import math

import numpy as np

from yesnt.relight.compiled import inlined, kernel

FEW = 4
"""Blocks of a cluster that are gathered one by one; to start a loop where they lie costs as much."""

TAIL = 0.08
"""Growth of the texels that a lobe bears, for each of its widths that they lie away from its core."""

LEAST_COSINE = 0.3
"""n.v below which a lobe is taken to grow no narrower across the plane of incidence: it grows longer along it."""

_1, _2, _3 = np.uintp(1), np.uintp(2), np.uintp(3)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)


def least_bearable(detail: float, alpha: float) -> float:
    """Size, rad, of the texels that lobes of that width bear at their cores; see choose."""
    return detail * 2 * alpha * LEAST_COSINE


@kernel
def choose(frame, sizes, size, cone, whole, facing, level, bearable):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
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
def at_the_horizon(start, cone, facing, behind, ground, places):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Lists blocks of level 0 (`ground`: zeros) of clusters that the horizon cuts: how many runs and single blocks."""
    mask = places[0]
    for c in range(facing.shape[0]):
        mask[c] = (behind[c] == 0) & (abs(facing[c]) <= cone[3, c])
    return _list_blocks(start, ground, places)


@kernel
def in_sight(start, cone, facing, behind, level, places):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Lists the blocks, at their levels, of clusters that are up and not hidden: how many runs and single blocks."""
    mask = places[0]
    for c in range(facing.shape[0]):
        mask[c] = (behind[c] == 0) & (level[c] >= 0) & (facing[c] > -cone[3, c])
    return _list_blocks(start, level, places)


@kernel
def _list_blocks(start, level, places):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Lists the blocks of masked clusters: more than FEW of one cluster as a run, else one by one.

    FEW places are written whatever there is: a loop of an unknown length would be guessed wrong most of the time.
    """
    mask, found, runs, blocks = places
    used = count = 0
    for i in range(_numbers(mask, found)):
        c = found[i]
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
def _numbers(mask, found):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which entries of a mask are set: how many. A branch would be guessed wrong half of the time."""
    count = 0
    for c in range(mask.shape[0]):
        found[count] = c
        count += mask[c]
    return count


@inlined
def _append(runs, used, first, last):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Adds a run or lengthens the last one: how many there are."""
    if used > 0 and runs[used - 1, 1] == first:
        runs[used - 1, 1] = last
        return used
    runs[used, 0], runs[used, 1] = first, last
    return used + 1
