"""A binary tree over a lat-long grid: its first C leaves are light clusters, its first T leaves are texels.

The leaf of largest importance times angular radius is split first. That product is, to first order, the light that
crosses a shadow edge times the width of the edge, when the leaf is replaced by one direction. Debevec's median cut
(2005) balances energy alone.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Box = tuple[int, int, int, int]  # rows [a, b), columns [c, d)

_EVEN_SHARE = 0.5  # of the mean luminance, added to all: indirect radiance comes from dark directions too


def importance(energy: Float, direction: Float, solid: Float) -> Float:
    """Moments [h, w, 4] of importance: luminance plus half of its mean, and the same times the direction.

    Args:
        energy: [h, w] luminance times solid angle.
        direction: [h, w, 3] unit.
        solid: [h, w] sr.
    """
    weight = energy + (_EVEN_SHARE * energy.sum() / solid.sum() + 1e-12) * solid
    return np.concatenate([weight[..., None], weight[..., None] * direction], axis=-1)


def grow(moments: Float, clusters: int, texels: int, multiple: int = 1) -> list[list[Box]]:
    """Boxes of the texels of every cluster, in Morton order, which keeps neighbours together.

    With at least as many texels as cells, every cell is a texel and only the clusters are grown. Otherwise about
    `texels` are made.

    Args:
        moments: [h, w, 4] of `importance`.
        clusters: number of clusters.
        texels: number of texels.
        multiple: each cluster gets a multiple of so many texels, if it has enough cells.
    """
    height, width = moments.shape[:2]
    table = np.pad(moments.cumsum(0).cumsum(1), ((1, 0), (1, 0), (0, 0)))
    leaves = _split(table, [[(0, height, 0, width)]], clusters)[0]
    order = sorted(leaves, key=_place)
    if texels >= height * width:
        return [[(r, r + 1, c, c + 1) for r in range(a, b) for c in range(e, f)] for a, b, e, f in order]
    wanted = texels - (multiple // 2) * len(order)  # rounding up adds half a multiple to each, on average
    groups = _split(table, [[box] for box in order], wanted)
    whole = [-(-len(group) // multiple) * multiple for group in groups]
    filled = [_split(table, [group], count)[0] for group, count in zip(groups, whole, strict=True)]
    return [sorted(group, key=_place) for group in filled]


def doublings(moments: Float, least: int, most: int) -> Iterator[list[Box]]:
    """Leaves of `least` clusters, of twice as many, and so on to `most`, as `grow` makes them.

    Args:
        moments: [h, w, 4] of `importance`.
        least: clusters of the first list.
        most: clusters of the last list.
    """
    table = np.pad(moments.cumsum(0).cumsum(1), ((1, 0), (1, 0), (0, 0)))
    leaves, count = [(0, moments.shape[0], 0, moments.shape[1])], least
    while True:
        leaves = _split(table, [leaves], min(count, most))[0]
        yield leaves
        if count >= most:
            return
        count *= 2


def _split(table: Float, groups: list[list[Box]], count: int) -> list[list[Box]]:
    """Splits the box of largest error of all groups until there are `count`; parts stay in their group."""
    leaves: list[list[Box]] = [[] for _ in groups]
    heap = [(-_error(table, box), i, box) for i, group in enumerate(groups) for box in group]
    heapq.heapify(heap)
    total = len(heap)
    while heap and total < count:
        error, i, box = heapq.heappop(heap)
        parts = _cut(table, box) if error < 0 else []
        if not parts:
            leaves[i].append(box)
            continue
        total += 1
        for part in parts:
            heapq.heappush(heap, (-_error(table, part), i, part))
    for _, i, box in heap:
        leaves[i].append(box)
    return leaves


def _place(box: Box) -> int:
    """Position of a box along a Morton curve through the grid."""
    return _morton(box[0] + box[1], box[2] + box[3])


def _error(table: Float, box: Box) -> float:
    """Importance times angular radius of a box, from the summed-area table [h + 1, w + 1, 4]; 0 for a single cell."""
    a, b, c, d = box
    if (b - a) * (d - c) == 1:
        return 0.0
    return float(_blur(table[b, d] - table[a, d] - table[b, c] + table[a, c]))


def _blur(moment: Float) -> Float:
    """Importance times angular radius of moments [..., 4]: the variance is 2 (w - |sum w d|) / w for small angles."""
    weight = moment[..., 0]
    variance = np.maximum(weight - np.sqrt(np.square(moment[..., 1:]).sum(-1)), 1e-12 * weight)
    return np.sqrt(weight * variance)


def _cut(table: Float, box: Box) -> list[Box]:
    """The two parts of a box after the cut, along rows or columns, of least error; none for a single cell."""
    a, b, c, d = box
    total = table[b, d] - table[a, d] - table[b, c] + table[a, c]
    upper = table[a + 1 : b, d] - table[a, d] - table[a + 1 : b, c] + table[a, c]
    left = table[b, c + 1 : d] - table[a, c + 1 : d] - table[b, c] + table[a, c]
    first = np.concatenate([upper, left])
    if len(first) == 0:
        return []
    best = int(np.argmin(_blur(first) + _blur(total - first)))
    if best < len(upper):
        k = a + 1 + best
        return [(a, k, c, d), (k, b, c, d)]
    k = c + 1 + best - len(upper)
    return [(a, b, c, k), (a, b, k, d)]


def _morton(row: int, column: int) -> int:
    """Interleaved bits: neighbours on the sphere stay neighbours in memory."""
    code = 0
    for bit in range(16):
        code |= ((row >> bit) & 1) << (2 * bit + 1) | ((column >> bit) & 1) << (2 * bit)
    return code
